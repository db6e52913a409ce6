"""Arrays that records of a structure point to: copied to a device, and the addresses with them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda import Gpu

#: Alignment of arrays that share an allocation: that of allocations.
_ALIGNMENT = 256


def _rounded(byte_count: int) -> int:
    return -(-byte_count // _ALIGNMENT) * _ALIGNMENT


class SharedAllocation:
    """Copies of contiguous arrays in one allocation: a scene may have thousands of objects.

    They must not change. A scene whose instances have moved has the same objects: their copies are
    shared as long as one of the two is in use.

    Parameters
    ----------
    gpu : Gpu
    name : str
        Of the layout, and for errors.
    arrays : sequence of ndarray
    copies : sequence of ndarray
        As they are, or in another layout.

    Attributes
    ----------
    memory : DeviceArray
    addresses : list of uint64
        Of the copies.

    Raises
    ------
    CudaError
        If there is no memory for them.
    """

    def __init__(
        self,
        gpu: Gpu,
        name: str,
        arrays: Sequence[NDArray[Any]],
        copies: Sequence[NDArray[Any]],
    ) -> None:
        self._arrays = tuple(arrays)  # while they are kept, no others have their addresses
        self.memory = gpu.empty(name, self.bytes_of(copies), np.uint8)
        self.addresses: list[np.uint64] = []
        first = 0
        for one in copies:
            part = self.memory.part(first, one.nbytes)
            if one.nbytes:
                part.fill(one.reshape(-1).view(np.uint8))
            self.addresses.append(part.address)
            first += _rounded(one.nbytes)
        _known[_key(gpu, name, arrays)] = self

    @staticmethod
    def bytes_of(arrays: Iterable[NDArray[Any]]) -> int:
        """Bytes of the allocation."""
        return sum(_rounded(one.nbytes) for one in arrays)

    @staticmethod
    def known(gpu: Gpu, name: str, arrays: Sequence[NDArray[Any]]) -> SharedAllocation | None:
        """The copies of these arrays that are in use, if there are any."""
        return _known.get(_key(gpu, name, arrays))


#: Copies in use, by device, name and the addresses of the arrays.
_known: WeakValueDictionary[tuple[Any, ...], SharedAllocation] = WeakValueDictionary()


def _key(gpu: Gpu, name: str, arrays: Iterable[NDArray[Any]]) -> tuple[Any, ...]:
    return gpu, name, *((one.ctypes.data, one.nbytes) for one in arrays)


class AddressMap:
    """Where the copies of host arrays are.

    Parameters
    ----------
    arrays : sequence of ndarray
    addresses : sequence of uint64
        Of their copies.
    """

    def __init__(self, arrays: Sequence[NDArray[Any]], addresses: Sequence[np.uint64]) -> None:
        rows = [
            (one.ctypes.data, one.nbytes, int(to))
            for one, to in zip(arrays, addresses, strict=True)
            if one.nbytes
        ]
        table = np.array(sorted(rows), np.uint64).reshape(-1, 3)
        self._starts, self._sizes, self._copies = table.T

    def addresses(self, given: NDArray[np.uint64]) -> NDArray[np.uint64]:
        """The addresses of what is at addresses in the arrays; 0 of any others.

        Empty arrays, which kernels never read, have those.
        """
        if not len(self._starts):
            return np.zeros_like(given)
        rows = np.searchsorted(self._starts, given, side="right")
        is_after = rows > 0
        rows = np.where(is_after, rows - 1, 0)
        offsets = given - self._starts[rows]
        is_inside = is_after & (offsets < self._sizes[rows])
        return np.where(is_inside, self._copies[rows] + offsets, np.uint64(0))

    def records(self, given: NDArray[Any], fields: Sequence[str]) -> NDArray[Any]:
        """Records with the addresses of copies in some fields."""
        moved = given.copy()
        for field in fields:
            moved[field] = self.addresses(given[field])
        return moved

    def replaced(self, view: Any, names: Sequence[str]) -> Mapping[str, np.uint64]:
        """Members of a tuple with the addresses of copies."""
        given = np.array([getattr(view, name) for name in names], np.uint64)
        return dict(zip(names, self.addresses(given), strict=True))
