"""Tables of a scene in GPU memory: arrays are copied, and their addresses replaced."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda import CudaError, DeviceArray, Gpu
from raystream.rendering.shading.keep_alive import AddressRow, kept_arrays

#: Suffix of uint64 fields that are not addresses.
_COUNT = "_count"


class _Region(NamedTuple):
    """A host array."""

    begin: int
    array: NDArray[Any]
    addresses: tuple[int, ...]

    @property
    def end(self) -> int:
        return self.begin + self.array.nbytes


class TableMemory:
    """Copies the arrays of tables to a device, each once.

    Parameters
    ----------
    gpu : Gpu
    kept : object
        Objects that keep the tables' arrays alive.

    Attributes
    ----------
    arrays : dict
        Copies by host address, to be kept as long as the tables are used.
    """

    def __init__(self, gpu: Gpu, kept: object) -> None:
        self._gpu = gpu
        self.arrays: dict[int, DeviceArray] = {}
        self._regions: list[_Region] = []
        for one in kept_arrays(kept):
            array, places = one if isinstance(one, AddressRow) else (one, ())
            if array.size:
                self._regions.append(_Region(array.ctypes.data, array, places))

    def placed(self, tables: Any) -> Any:
        """Replace the addresses in a named tuple of tables.

        Fields of type uint64 are addresses, or 0, unless their names end in ``_count``.

        Raises
        ------
        CudaError
            If there is no memory for the arrays.
        LookupError
            If an address is not in a kept array.
        """
        return tables._make(
            self._value(name, value) for name, value in zip(tables._fields, tables, strict=True)
        )

    def _value(self, name: str, value: Any) -> Any:
        if isinstance(value, np.uint64) and not name.endswith(_COUNT):
            return self._address(name, int(value))
        return self.placed(value) if hasattr(value, "_fields") else value

    def _address(self, name: str, address: int) -> np.uint64:
        if address == 0:
            return np.uint64(0)
        for region in self._regions:
            if region.begin <= address < region.end:
                return self._copied(name, region) + np.uint64(address - region.begin)
        raise LookupError(f"{name}: nothing is kept at its address")

    def _copied(self, name: str, region: _Region) -> np.uint64:
        if region.begin not in self.arrays:
            array = region.array
            if region.addresses:
                array = array.copy()
                numbers = array.view(np.uint64)
                for place in region.addresses:
                    numbers[place] = self._address(f"{name}, {place}", int(numbers[place]))
            free = self._gpu.free_byte_count()
            if array.nbytes > free:
                raise CudaError(
                    f"device 'cuda': the scene's {name} take {array.nbytes:,} bytes, but "
                    f"{self._gpu.name} has {free:,} free; use device='cpu'"
                )
            self.arrays[region.begin] = self._gpu.upload(f"the scene's {name}", array)
        return self.arrays[region.begin].address
