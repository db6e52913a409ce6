"""CudaStream: the order in which a device does what it is given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from raystream.jit.cuda.simulation import is_simulated

if TYPE_CHECKING:
    from raystream.jit.cuda.gpu import Gpu

__all__ = ["LEGACY", "CudaStream"]

#: Handles that have a meaning of their own: the default streams.
LEGACY, PER_THREAD = 1, 2


class CudaStream:
    """A stream of a device: a caller's, or one of ours.

    Parameters
    ----------
    gpu : Gpu
    handle : int
        As ``__cuda_array_interface__`` and DLPack give it: 1 is the legacy default stream, 2 the
        default stream of the thread. A caller's has to exist as long as it is used.
    native : cuda.core.Stream, optional
        The same; without it, one is made around the handle.

    Attributes
    ----------
    handle : int
    native : cuda.core.Stream or None
        None in the simulator, where all is done at once.
    """

    def __init__(self, gpu: Gpu, handle: int, native: Any = None) -> None:
        self._gpu = gpu
        self.handle = handle
        self.native = native
        if native is None and not is_simulated():
            self.native = _around(handle)

    @classmethod
    def make(cls, gpu: Gpu, *, is_blocking: bool) -> CudaStream:
        """Make a new one.

        Parameters
        ----------
        gpu : Gpu
            The current device.
        is_blocking : bool
            Whether it and the legacy default stream wait for each other.
        """
        if is_simulated():
            return cls(gpu, LEGACY)
        from cuda.core import Device, StreamOptions

        options = StreamOptions(nonblocking=not is_blocking)
        native = Device(gpu.number).create_stream(options=options)
        return cls(gpu, int(native.handle), native)

    def wait(self, other: CudaStream) -> None:
        """Do what comes next after all that another stream was given so far.

        Raises
        ------
        CudaError
            If one of them is no stream of the device.
        """
        if other.handle != self.handle and not is_simulated():
            with self._gpu.doing("ordering its streams"):
                self.native.wait(other.native)

    def sync(self) -> None:
        """Wait on the host until all is done.

        Raises
        ------
        CudaError
            If some of it failed.
        """
        self._gpu.wait(self.native)


def _around(handle: int) -> Any:
    from cuda.core import LEGACY_DEFAULT_STREAM, PER_THREAD_DEFAULT_STREAM, Stream

    known = {LEGACY: LEGACY_DEFAULT_STREAM, PER_THREAD: PER_THREAD_DEFAULT_STREAM}
    return known[handle] if handle in known else Stream.from_handle(handle)
