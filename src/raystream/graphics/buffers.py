"""Buffers of a graphics device: upload and readback."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError

#: A binding holds at least one element: this is the largest one.
_MIN_BYTES = 64


class Buffer:
    """A storage buffer that can be grown, without its content.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.

    Attributes
    ----------
    handle : GPUBuffer or None
        None until `reserve` is called.
    """

    def __init__(self, opened: OpenDevice, name: str) -> None:
        self._opened = opened
        self._name = name
        self._byte_count = 0
        self.handle: Any = None

    def reserve(self, byte_count: int) -> bool:
        """Grow to a number of bytes if needed; returns whether the buffer is a new one."""
        wanted = max(byte_count, _MIN_BYTES)
        if wanted <= self._byte_count:
            return False
        check_size(self._opened, self._name, wanted)
        self.handle = _new_buffer(self._opened, wanted, self._name, _storage())
        self._byte_count = wanted
        return True

    def write(self, array: NDArray[Any]) -> None:
        """Copy an array to its beginning."""
        if array.nbytes:
            self._opened.device.queue.write_buffer(self.handle, 0, np.ascontiguousarray(array))

    def read(self, dtype: Any, shape: tuple[int, ...], offset: int = 0) -> NDArray[Any]:
        """Wait for the device, and copy a part back, from an offset in bytes on."""
        byte_count = int(np.dtype(dtype).itemsize * np.prod(shape, dtype=np.int64))
        if byte_count == 0:
            return np.empty(shape, dtype)
        try:
            memory = self._opened.device.queue.read_buffer(self.handle, offset, byte_count)
        except Exception as error:  # wgpu wraps all errors of a driver
            raise GraphicsError(
                f"device 'graphics': {self._opened.adapter}: {self._name} cannot be read: {error}"
            ) from error
        return np.frombuffer(memory, dtype).reshape(shape)

    @property
    def binding(self) -> dict[str, Any]:
        """The buffer as a resource of a bind group."""
        return {"buffer": self.handle, "offset": 0, "size": self._byte_count}


class ReadBack:
    """Reads several buffers back at once.

    Parameters
    ----------
    opened : OpenDevice
    """

    def __init__(self, opened: OpenDevice) -> None:
        self._opened = opened
        self._memory: Any = None

    def read(self, encoder: Any, parts: Sequence[tuple[Buffer, int]]) -> list[NDArray[np.uint8]]:
        """Submit encoded commands, wait, and copy the beginnings of buffers back.

        Parameters
        ----------
        encoder : GPUCommandEncoder
            It is finished.
        parts : sequence of (Buffer, int)
            Buffers and the bytes to read of each: multiples of 4.

        Returns
        -------
        list of ndarray of uint8
        """
        sizes = [size for _, size in parts]
        offsets = [0, *itertools.accumulate(-(-size // 8) * 8 for size in sizes)]
        memory = self._with_room(offsets[-1])
        for (buffer, size), offset in zip(parts, offsets, strict=False):
            if size:
                encoder.copy_buffer_to_buffer(buffer.handle, 0, memory, offset, size)
        self._opened.device.queue.submit([encoder.finish()])
        self._memory = None  # dropped, if interrupted while mapped
        memory.map_sync("READ", 0, offsets[-1])
        mapped = np.frombuffer(memory.read_mapped(copy=False), np.uint8)
        copies = [
            mapped[offset : offset + size].copy()
            for size, offset in zip(sizes, offsets, strict=False)
        ]
        memory.unmap()
        self._memory = memory
        return copies

    def _with_room(self, byte_count: int) -> Any:
        import wgpu

        if self._memory is None or self._memory.size < byte_count:
            usage = wgpu.BufferUsage.MAP_READ | wgpu.BufferUsage.COPY_DST
            self._memory = _new_buffer(self._opened, byte_count, "results", usage)
        return self._memory


def check_size(opened: OpenDevice, name: str, byte_count: int) -> None:
    """Raise GraphicsError for a buffer larger than the device allows."""
    most = min(opened.limits["max-storage-buffer-binding-size"], opened.limits["max-buffer-size"])
    if byte_count > most:
        raise GraphicsError(
            f"device 'graphics': {name} would take {byte_count:,} bytes, but {opened.adapter} "
            f"allows {most:,} in a buffer; trace a smaller scene, or use device='cpu'"
        )


def upload(opened: OpenDevice, arrays: Iterable[tuple[str, NDArray[Any]]]) -> list[Buffer]:
    """Copy named arrays to new buffers."""
    buffers = []
    for name, array in arrays:
        buffer = Buffer(opened, name)
        buffer.reserve(array.nbytes)
        buffer.write(array)
        buffers.append(buffer)
    return buffers


def uniform(opened: OpenDevice, content: bytes) -> Any:
    """A uniform buffer, padded to whole vectors of four words."""
    import wgpu

    padded = content + bytes(-len(content) % 16)
    return opened.device.create_buffer_with_data(
        data=padded, usage=wgpu.BufferUsage.UNIFORM | wgpu.BufferUsage.COPY_DST
    )


def whole(buffer: Any) -> dict[str, Any]:
    """A wgpu buffer as a resource of a bind group."""
    return {"buffer": buffer, "offset": 0, "size": buffer.size}


def _storage() -> int:
    import wgpu

    return wgpu.BufferUsage.STORAGE | wgpu.BufferUsage.COPY_SRC | wgpu.BufferUsage.COPY_DST


def _new_buffer(opened: OpenDevice, byte_count: int, name: str, usage: int) -> Any:
    try:
        return opened.device.create_buffer(size=-(-byte_count // 16) * 16, usage=usage)
    except Exception as error:  # wgpu wraps all errors of a driver
        raise GraphicsError(
            f"device 'graphics': {opened.adapter} has no memory for {name}, {byte_count:,} bytes: "
            f"{error}"
        ) from error
