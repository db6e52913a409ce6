"""Arrays that begin at a cache line."""

from __future__ import annotations

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
