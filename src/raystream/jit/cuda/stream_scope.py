"""StreamScope: asynchronous launches and scratch memory in a caller's stream, for one query."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from raystream.jit.cuda.device_array import DeviceArray
from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.range_kernel import RangeKernel
from raystream.jit.cuda.streams import CudaStream


class StreamScope:
    """A context in which kernels are launched in a stream, without waiting on the host.

    Memory is allocated and freed in the order of the device's own stream. The caller's stream
    waits for that one before it uses memory, and that one waits for the caller's at the end, so
    that neither stream has to outlive the other.

    Parameters
    ----------
    gpu : Gpu
    stream : CudaStream
        Where kernels run.
    """

    def __init__(self, gpu: Gpu, stream: CudaStream) -> None:
        self.gpu, self.stream = gpu, stream
        self._kept: list[Any] = []
        self._memory: list[DeviceArray] = []
        self._others: list[CudaStream] = []
        self._has_new_memory = False

    def __enter__(self) -> StreamScope:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            self.join()
        except CudaError:
            if error is None:
                raise

    def nested(self) -> StreamScope:
        """A scope in the same stream whose memory is freed earlier."""
        return StreamScope(self.gpu, self.stream)

    def keep(self, *objects: Any) -> None:
        """Keep objects alive until all launches are done."""
        self._kept.extend(objects)

    def borrow(self, stream: CudaStream) -> None:
        """Wait for another stream of the caller's, and let it wait for this one at the end."""
        if all(stream.handle != other.handle for other in self._others):
            self.stream.wait(stream)
            self._others.append(stream)

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an uninitialised array.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        made = self.gpu.pooled(name, shape, dtype)
        self._memory.append(made)
        self._has_new_memory = True
        return made

    def ready(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an uninitialised array that the stream can use at once.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        made = self.empty(name, shape, dtype)
        self.follow()
        return made

    def cleared(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an array of zeros."""
        made = self.ready(name, shape, dtype)
        self.gpu.clear(made, self.stream)
        return made

    def placed(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Upload a small host array in C order."""
        made = self.ready(name, array.shape, array.dtype)
        self.gpu.copy(made.address, array.ctypes.data, array.nbytes, self.stream)
        return made

    def launch(self, kernel: RangeKernel, count: int, arguments: tuple[Any, ...]) -> None:
        """Launch a kernel; see `RangeKernel.launch`."""
        self.follow()
        kernel.launch(self.gpu, count, arguments, self.stream.native)

    def read(self, array: DeviceArray) -> NDArray[Any]:
        """Copy an array to the host, after waiting for all launches so far.

        Raises
        ------
        CudaError
            If one of them failed.
        """
        self.gpu.stream.wait(self.stream)
        return array.host()

    def join(self) -> None:
        """Let the device's own stream, and borrowed ones, wait for all launches.

        After that memory may be freed, in the order of the device's own stream.
        """
        for other in (self.gpu.stream, *self._others):
            other.wait(self.stream)
        if self._kept:
            with self.gpu.doing("keeping arrays"):
                self.gpu.keep_alive.keep(self.gpu.stream, self._kept)
        self._kept, self._memory = [], []

    def follow(self) -> None:
        """Let the stream wait for newly allocated memory, before the next launch or copy."""
        if self._has_new_memory:
            self.stream.wait(self.gpu.stream)
            self._has_new_memory = False
