"""Staging streams: copies through pinned memory that overlap with kernels of other streams."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda import CudaError, CudaStream, DeviceArray, Gpu, StreamScope

#: Streams of a query: one copies while the other traces.
STREAM_COUNT = 2

#: Alignment of arrays in pinned memory, in bytes.
_ALIGNMENT = 64


class StagingStream:
    """A stream with pinned memory, for one part of the rays at a time.

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
        """Begin a new part: reuses the pinned memory of the last one."""
        if len(self._pieces) > 1:  # merge them
            byte_count = sum(map(len, self._pieces))
            self._pieces = []  # free them first
            self._pieces = [self._gpu.pinned(byte_count)]
        self._piece, self._used = 0, 0

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an uninitialised array on the device.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        return self._gpu.pooled(name, shape, dtype, self.stream)

    def cleared(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an array of zeros on the device."""
        made = self.empty(name, shape, dtype)
        self._gpu.clear(made, self.stream)
        return made

    def upload(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Start a copy to the device; the array may be changed at once.

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
        """Start a copy of an array of this stream to the host.

        Returns
        -------
        ndarray
            Valid after `finish`, until `begin`.
        """
        pinned = self._pinned(array.shape, array.dtype)
        self._gpu.copy(pinned.ctypes.data, array.address, pinned.nbytes, self.stream)
        return pinned

    def finish(self) -> None:
        """Wait for the stream.

        Raises
        ------
        CudaError
            If a kernel or copy failed.
        """
        self.stream.sync()

    def _pinned(self, shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
        """Pinned memory that is in use until `begin`."""
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

    def join(self) -> None:
        """Free the memory, in the order of its stream: no other stream has to wait."""
        self._kept, self._memory = [], []

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an uninitialised array."""
        made = self._staging.empty(name, shape, dtype)
        self._memory.append(made)
        return made

    def placed(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Start a copy from the host; the array may be changed at once."""
        made = self._staging.upload(name, array)
        self._memory.append(made)
        return made


class StagingStreams:
    """The staging streams of a backend, kept from query to query.

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
        """Streams for one query; queries in other threads use others.

        On exit, also after an exception, the streams are idle.
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
        """Wait for launches that an exception left behind, before their memory is freed."""
        try:
            for stream in streams:
                stream.finish()
        except CudaError:  # the device is lost
            return
        with self._lock:
            self._free += streams
