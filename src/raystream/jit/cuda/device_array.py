"""DeviceArray: an array in GPU memory, shared with other libraries without copies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.streams import LEGACY, CudaStream

if TYPE_CHECKING:
    from raystream.jit.cuda.gpu import Gpu

#: Alignment of arrays in bytes, the same as CUDA's: traversals need 256.
ALIGNMENT = 256

#: DLPack's device types.
_CPU, _CUDA = 1, 2


class DeviceArray:
    """A C-contiguous array in GPU memory.

    Other libraries read and write it without a copy, through ``__cuda_array_interface__`` (CuPy,
    Numba, PyTorch) or DLPack (these and JAX).

    Parameters
    ----------
    gpu : Gpu
    name : str
        For errors.
    owner : object
        Frees the memory when it is no longer referenced; an ndarray in the simulator.
    address : int
    shape : tuple of int
    dtype : dtype
    stream : CudaStream
        Stream in whose order the memory is allocated, filled, read and freed.

    Attributes
    ----------
    address : uint64
    shape : tuple of int
    dtype : dtype
    stream : CudaStream
    """

    def __init__(
        self,
        gpu: Gpu,
        name: str,
        owner: Any,
        address: int,
        shape: tuple[int, ...],
        dtype: Any,
        stream: CudaStream,
    ) -> None:
        self._gpu, self._name, self._owner = gpu, name, owner
        self.address = np.uint64(address)
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self.stream = stream

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Size in bytes."""
        return self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return self.shape[0]

    def host(self) -> NDArray[Any]:
        """Copy it to the host, after waiting for its stream.

        Raises
        ------
        CudaError
            If work in the stream failed.
        """
        made = np.empty(self.shape, self.dtype)
        with self._gpu.doing(f"reading {self._name}"):
            self._gpu.copy(made.ctypes.data, self.address, self.nbytes, self.stream)
            self.stream.sync()
        return made

    def fill(self, array: NDArray[Any]) -> None:
        """Fill it from a host array of the same shape and dtype.

        Raises
        ------
        CudaError
            If this or earlier work in the stream fails.
        """
        given = np.ascontiguousarray(array, self.dtype)
        with self._gpu.doing(f"writing {self._name}"):
            self._gpu.copy(self.address, given.ctypes.data, self.nbytes, self.stream)
            self.stream.sync()

    def shaped(self, shape: tuple[int, ...], dtype: Any = None) -> DeviceArray:
        """The same memory with another shape, or another dtype of the same size."""
        kind = self.dtype if dtype is None else np.dtype(dtype)
        return DeviceArray(
            self._gpu, self._name, self._owner, int(self.address), shape, kind, self.stream
        )

    def part(self, first: int, count: int) -> DeviceArray:
        """A range of its elements in C order, of shape (count,)."""
        made = self.shaped((count,))
        made.address = self.address + np.uint64(first * self.dtype.itemsize)
        return made

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return self._interface(int(self.address) if self.size else 0)

    def _interface(self, address: int) -> dict[str, Any]:
        return {
            "shape": self.shape,
            "typestr": self.dtype.str,
            "data": (address, False),
            "strides": None,
            "stream": self.stream.handle,
            "version": 3,
        }

    def __dlpack_device__(self) -> tuple[int, int]:
        return (_CPU, 0) if is_simulated() else (_CUDA, self._gpu.number)

    def __dlpack__(
        self,
        *,
        stream: int | None = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """Export it through DLPack, for ``from_dlpack`` of other libraries.

        Raises
        ------
        BufferError
            If another device or a copy is requested.
        """
        if dl_device not in (None, self.__dlpack_device__()):
            raise BufferError(f"the array is on device {self.__dlpack_device__()}")
        if copy:
            raise BufferError("copies are not supported; copy the imported array")
        if is_simulated():
            return _viewed(self).__dlpack__(max_version=max_version)
        from cuda.core.utils import StridedMemoryView

        if stream != -1:  # the consumer's stream; None is the legacy default stream
            CudaStream(self._gpu, stream or LEGACY).wait(self.stream)
        with self._gpu.doing(f"exporting {self._name}"):
            view = StridedMemoryView.from_cuda_array_interface(_Lent(self), stream_ptr=-1)
            return view.__dlpack__(max_version=max_version)

    def __repr__(self) -> str:
        return f"DeviceArray(shape={self.shape}, dtype={self.dtype}, gpu={self._gpu.number})"


class _Lent:
    """An array as cuda-core reads it: with an address even if it is empty."""

    def __init__(self, array: DeviceArray) -> None:
        self.array = array
        self.__cuda_array_interface__ = array._interface(int(array.address))


def _viewed(array: DeviceArray) -> NDArray[Any]:
    """An array of the simulated device as a NumPy array."""
    memory: NDArray[np.uint8] = array._owner
    skipped = int(array.address) - memory.ctypes.data
    return memory[skipped : skipped + array.nbytes].view(array.dtype).reshape(array.shape)


def host_memory(byte_count: int) -> tuple[NDArray[np.uint8], int]:
    """Memory of the simulated device, and an aligned address in it."""
    memory = np.empty(byte_count + ALIGNMENT, np.uint8)
    return memory, memory.ctypes.data + -memory.ctypes.data % ALIGNMENT
