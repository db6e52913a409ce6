"""Work: kernels in a caller's stream, with the memory that they need."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from numpy.typing import NDArray

from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.kernels import RangeKernel
from raystream.jit.cuda.memory import DeviceArray
from raystream.jit.cuda.streams import CudaStream

__all__ = ["Work"]


class Work:
    """What a device is given for one query, in a stream, without waiting on the host.

    Memory is had and freed in the order of the device's own stream. The caller's waits for that
    one before it uses memory, and that one waits for the caller's at the end: so neither has
    to exist longer than the other.

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
        self._is_new = False

    def __enter__(self) -> Work:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.join()
        except CudaError:
            if error is None:
                raise

    def keep(self, *objects: Any) -> None:
        """Keep objects until all is done."""
        self._kept.extend(objects)

    def borrow(self, stream: CudaStream) -> None:
        """Follow another stream of the caller's now, and let it follow at the end."""
        if all(stream.handle != other.handle for other in self._others):
            self.stream.wait(stream)
            self._others.append(stream)

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array, not initialised.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        made = self.gpu.pooled(name, shape, dtype)
        self._memory.append(made)
        self._is_new = True
        return made

    def ready(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array that may be used in the stream at once, not initialised.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        made = self.empty(name, shape, dtype)
        self.follow()
        return made

    def cleared(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array of zeros."""
        made = self.ready(name, shape, dtype)
        self.gpu.clear(made, self.stream)
        return made

    def placed(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Copy a small array of the host's, in C order, to the device."""
        made = self.ready(name, array.shape, array.dtype)
        self.gpu.copy(made.address, array.ctypes.data, array.nbytes, self.stream)
        return made

    def launch(self, kernel: RangeKernel, count: int, arguments: tuple[Any, ...]) -> None:
        """Begin to run a kernel; see `RangeKernel.launch`."""
        self.follow()
        kernel.launch(self.gpu, count, arguments, self.stream.native)

    def read(self, array: DeviceArray) -> NDArray[Any]:
        """A copy of an array on the host, when all so far is done: this waits.

        Raises
        ------
        CudaError
            If some of it failed.
        """
        self.gpu.stream.wait(self.stream)
        return array.host()

    def join(self) -> None:
        """Let the device's own stream, and those borrowed, follow what was begun.

        Then memory may go: it is freed in the order of the device's own stream.
        """
        for other in (self.gpu.stream, *self._others):
            other.wait(self.stream)
        if self._kept:
            with self.gpu.doing("keeping arrays"):
                self.gpu.in_flight.keep(self.gpu.stream, self._kept)
        self._kept, self._memory = [], []

    def follow(self) -> None:
        """Let the stream wait for memory that is new: before anything is begun in it."""
        if self._is_new:
            self.stream.wait(self.gpu.stream)
            self._is_new = False
