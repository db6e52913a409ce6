"""StagingStreams: two streams that take turns, so that one copies while the other traces.

A device copies from and to pinned memory of the host while it computes. So what goes to it is first
put into such memory, and what comes back is taken out of it.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda import CudaError, CudaStream, DeviceArray, Gpu, StreamScope

__all__ = ["STREAM_COUNT", "StagedScope", "StagingStream", "StagingStreams"]

#: One copies in or out while the other traces.
STREAM_COUNT = 2

#: Pieces of pinned memory begin at multiples of so many bytes.
_ALIGNMENT = 64


class StagingStream:
    """A stream with pinned memory, for one part of the rays after the other.

    Parameters
    ----------
    gpu : Gpu
    """

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = self.gpu = gpu
        with gpu.doing("making a stream"):
            self.stream = CudaStream.make(gpu, is_blocking=False)
        self._pieces: list[NDArray[np.uint8]] = []
        self._piece, self._used = 0, 0

    def begin(self) -> None:
        """Begin a new part: the memory of the latest one is free again."""
        if len(self._pieces) > 1:  # what took several pieces gets one
            byte_count = sum(map(len, self._pieces))
            self._pieces = []  # before there is another
            self._pieces = [self._gpu.pinned(byte_count)]
        self._piece, self._used = 0, 0

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array on the device, not initialised.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        return self._gpu.pooled(name, shape, dtype, self.stream)

    def cleared(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array of zeros on the device."""
        made = self.empty(name, shape, dtype)
        self._gpu.clear(made, self.stream)
        return made

    def upload(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Begin to copy an array to the device; it may be changed at once.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        pinned = self._pinned(array.shape, array.dtype)
        np.copyto(pinned, array)
        made = self.empty(name, array.shape, array.dtype)
        self._gpu.copy(made.address, pinned.ctypes.data, pinned.nbytes, self.stream)
        return made

    def download(self, array: DeviceArray) -> NDArray[Any]:
        """Begin to copy an array of this stream to the host.

        Returns
        -------
        ndarray
            It has the numbers after `finish`, until `begin`.
        """
        pinned = self._pinned(array.shape, array.dtype)
        self._gpu.copy(pinned.ctypes.data, array.address, pinned.nbytes, self.stream)
        return pinned

    def finish(self) -> None:
        """Wait until all that was begun is done.

        Raises
        ------
        CudaError
            If some of it failed.
        """
        self.stream.sync()

    def _pinned(self, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """Some pinned memory, that nothing else has before `begin`."""
        dtype = np.dtype(dtype)
        byte_count = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        while self._piece < len(self._pieces):
            piece = self._pieces[self._piece]
            if self._used + byte_count <= len(piece):
                break
            self._piece, self._used = self._piece + 1, 0
        else:
            piece = self._gpu.pinned(max(byte_count, 1 << 16))
            self._pieces.append(piece)
        first, self._used = self._used, -(-(self._used + byte_count) // _ALIGNMENT) * _ALIGNMENT
        return piece[first : first + byte_count].view(dtype).reshape(shape)


class StagedScope(StreamScope):
    """A scope in a staging stream, in whose order memory is allocated and freed.

    Parameters
    ----------
    staging : StagingStream
    """

    def __init__(self, staging: StagingStream) -> None:
        super().__init__(staging.gpu, staging.stream)
        self._staging = staging

    def nested(self) -> StagedScope:
        """A scope in the same stream whose memory is freed earlier."""
        return StagedScope(self._staging)

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array, not initialised."""
        made = self._staging.empty(name, shape, dtype)
        self._memory.append(made)
        return made

    def placed(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Begin to copy an array of the host to the device; it may be changed at once."""
        made = self._staging.upload(name, array)
        self._memory.append(made)
        return made


class StagingStreams:
    """The streams of a machine, kept from query to query.

    Parameters
    ----------
    gpu : Gpu
    """

    def __init__(self, gpu: Gpu) -> None:
        self._gpu = gpu
        self._free: list[StagingStream] = []
        self._lock = threading.Lock()

    @contextmanager
    def taken(self, count: int = STREAM_COUNT) -> Iterator[list[StagingStream]]:
        """StagingStreams for one query: queries in other threads have others.

        However it ends, they are empty then.
        """
        with self._lock:
            streams = [self._free.pop() for _ in range(min(count, len(self._free)))]
        try:
            while len(streams) < count:
                streams.append(StagingStream(self._gpu))
            yield streams
        except BaseException:
            self._empty(streams)
            raise
        with self._lock:
            self._free += streams

    def _empty(self, streams: list[StagingStream]) -> None:
        """Wait for what an exception left behind, for whose memory is freed next."""
        try:
            for stream in streams:
                stream.finish()
        except CudaError:  # the device is lost: so are they
            return
        with self._lock:
            self._free += streams
