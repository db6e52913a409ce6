"""Arrays that begin at a cache line, and the addresses of arrays."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Bytes of a cache line.
ALIGNMENT = 64


def aligned_array(row_count: int, row_floats: int) -> NDArray[np.float32]:
    """Uninitialised float32 array of shape (row_count, row_floats) that begins at a cache line."""
    byte_count = row_count * row_floats * 4
    memory = np.empty(byte_count + ALIGNMENT, np.uint8)
    skipped = -memory.ctypes.data % ALIGNMENT
    return memory[skipped : skipped + byte_count].view(np.float32).reshape(row_count, row_floats)


def array_address(array: NDArray[Any]) -> int:
    """The address of an array's first number.

    From the buffer of a writable, contiguous, not empty array: 0.25 us against 0.9 us, of about
    20 us that a query of one ray takes.
    """
    buffer: Any = array
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(buffer))
    except (TypeError, ValueError, BufferError):
        return array.ctypes.data


def array_places(*arrays: NDArray[Any]) -> Any:
    """The addresses of arrays as kernels take them; the caller keeps the arrays alive."""
    return map(np.uint64, map(array_address, arrays))
