"""CudaStream: an ordered queue of a device's work."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.jit.cuda.simulation import is_simulated

if TYPE_CHECKING:
    from raystream.jit.cuda.gpu import Gpu

#: Reserved handles, of the default streams.
LEGACY, PER_THREAD = 1, 2


class CudaStream:
    """A CUDA stream, of a caller or our own.

    Parameters
    ----------
    gpu : Gpu
    handle : int
        As in ``__cuda_array_interface__`` and DLPack: 1 is the legacy default stream, 2 the
        per-thread default stream. A caller's stream must outlive this object.
    native : cuda.core.Stream, optional
        [default: made from the handle]

    Attributes
    ----------
    handle : int
    native : cuda.core.Stream or None
        None in the simulator, which is synchronous.
    """

    def __init__(self, gpu: Gpu, handle: int, native: Any = None) -> None:
        self._gpu = gpu
        self.handle = handle
        self.native = native
        if native is None and not is_simulated():
            self.native = _around(handle)

    @classmethod
    def make(cls, gpu: Gpu, *, is_blocking: bool) -> CudaStream:
        """Create a stream.

        Parameters
        ----------
        gpu : Gpu
            The current device.
        is_blocking : bool
            Whether it synchronises with the legacy default stream.
        """
        if is_simulated():
            return cls(gpu, LEGACY)
        from cuda.core import Device, StreamOptions

        options = StreamOptions(nonblocking=not is_blocking)
        device = Device(gpu.number)  # this thread's own object, which must have been set current
        device.set_current()
        native = device.create_stream(options=options)
        return cls(gpu, int(native.handle), native)

    def wait(self, other: CudaStream) -> None:
        """Let later work wait for all work queued so far in another stream.

        Raises
        ------
        CudaError
            If one of them is not a stream of the device.
        """
        if other.handle != self.handle and not is_simulated():
            with self._gpu.doing("ordering its streams"):
                self.native.wait(other.native)

    def sync(self) -> None:
        """Wait on the host until all queued work is done.

        Raises
        ------
        CudaError
            If it failed.
        """
        self._gpu.wait(self.native)


def _around(handle: int) -> Any:
    from cuda.core import LEGACY_DEFAULT_STREAM, PER_THREAD_DEFAULT_STREAM, Stream

    known = {LEGACY: LEGACY_DEFAULT_STREAM, PER_THREAD: PER_THREAD_DEFAULT_STREAM}
    return known[handle] if handle in known else Stream.from_handle(handle)
