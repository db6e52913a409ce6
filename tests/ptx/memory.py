"""Memory of the PTX interpreter, which checks that accesses are aligned and within an array.

So the interpreter finds what compute-sanitizer's memcheck finds on a device. Compilers load values
speculatively, so reading memory that was never written is no error: it is `UNWRITTEN` at first.
"""

from __future__ import annotations

import bisect
from typing import NamedTuple

import numpy as np

#: Initial value of a byte of memory: numbers made of it are neither 0 nor small.
UNWRITTEN = 0xA5


class PtxError(Exception):
    """A kernel does something that fails, or is undefined, on a device."""


class _Region(NamedTuple):
    """Bytes at an address."""

    name: str
    start: int
    data: memoryview


def room_for(byte_count: int, align: int) -> np.ndarray:
    """Bytes that begin at a multiple of `align`."""
    room = np.full(byte_count + align, UNWRITTEN, np.uint8)
    begin = -room.ctypes.data % align
    return room[begin : begin + byte_count]


class Memory:
    """Regions by address."""

    def __init__(self):
        self._starts: list[int] = []
        self._regions: list[_Region] = []

    def add(self, name: str, room: np.ndarray) -> int:
        """Make bytes of the host accessible to kernels; returns their address."""
        start = int(room.ctypes.data)
        i = bisect.bisect(self._starts, start)
        self._starts.insert(i, start)
        self._regions.insert(i, _Region(name, start, memoryview(room)))
        return start

    def drop(self, start: int) -> None:
        """Remove a region; later accesses to it fail."""
        i = bisect.bisect_left(self._starts, start)
        assert self._starts[i] == start
        del self._starts[i], self._regions[i]

    def _find(self, address: int, size: int, what: str) -> memoryview:
        if address % size:
            raise PtxError(f"{what} {size} bytes, {address % size} behind where they may begin")
        i = bisect.bisect(self._starts, address) - 1
        if i < 0:
            raise PtxError(f"{what} {size} bytes at {address:#x}, where nothing is")
        region = self._regions[i]
        offset = address - region.start
        behind = offset + size - len(region.data)
        if behind > 0:
            raise PtxError(
                f"{what} {size} bytes, of which {behind} or more lie behind {region.name}"
            )
        return region.data[offset : offset + size]

    def read(self, address: int, size: int) -> bytes:
        """Bytes.

        Raises
        ------
        PtxError
            If they are not all in one array, or not aligned.
        """
        return bytes(self._find(address, size, "reads"))

    def write(self, address: int, data: bytes) -> None:
        """Write bytes; see `read`."""
        self._find(address, len(data), "writes")[:] = data
