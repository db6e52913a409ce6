"""Vectors of any layout copied to adjacent rows, on all threads.

NumPy copies rows of three numbers one by one on one thread: columns of wider records took 1.8
times the time of tracing them, transposed images 3.7 times.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, prefetch, store
from raystream.jit.threads import parallel_for

#: Side of the tiles in which images are copied: the lines of memory that a transposed image's
#: columns share are read once, and stay in the L1 cache until then.
_SIDE = 8
_LINE = np.uint64(64)

#: Bytes that one call of the kernel copies, about.
_BYTES = 1 << 18


def rows_of(vectors: Any) -> Any:
    """An image's vectors as rows, copied on all threads, where NumPy would have to copy them.

    Parameters
    ----------
    vectors : array_like of shape (..., 3)

    Returns
    -------
    ndarray of shape (H, W, 3), or the argument
        With adjacent rows, if the argument is an array of shape (H, W, 3), float32 or float64,
        whose rows are not at equal distances in memory.
    """
    if (
        not isinstance(vectors, np.ndarray)
        or vectors.ndim != 3
        or vectors.strides[0] == vectors.strides[1] * vectors.shape[1]
        or vectors.shape[-1] != 3
        or vectors.dtype not in (np.float32, np.float64)
    ):
        return vectors
    return adjacent_rows(vectors)


def adjacent_rows(vectors: NDArray[Any]) -> NDArray[Any]:
    """Copy vectors to adjacent rows.

    Parameters
    ----------
    vectors : ndarray of shape (N, 3) or (H, W, 3)
        Of any layout.

    Returns
    -------
    ndarray of the same shape and dtype
        C-contiguous.
    """
    if not vectors.flags.aligned or not vectors.dtype.isnative or vectors.itemsize not in (4, 8):
        return np.ascontiguousarray(vectors)
    copied = np.empty(vectors.shape, vectors.dtype)
    inner = 1 if vectors.ndim == 2 else vectors.shape[1]
    inner_step = 0 if vectors.ndim == 2 else vectors.strides[1]
    steps = vectors.strides[0], inner_step, vectors.strides[-1]
    arguments = [vectors.ctypes.data, copied.ctypes.data, inner, *(step % 2**64 for step in steps)]
    shared: Any = *map(np.uint64, arguments), vectors.itemsize == 8

    def body(begin: int, end: int) -> None:
        _copy(begin, end, *shared)

    row_bytes = max(inner, 1) * 3 * vectors.itemsize
    chunk = max(_BYTES // (row_bytes * _SIDE), 1) * _SIDE
    parallel_for(body, len(vectors), chunk, joins_chunks=True)
    return copied


@device
def _copy_run(source, distance, step, target, count, is_double):
    """Copy vectors that are at equal distances."""
    size = np.uint64(8) if is_double else np.uint64(4)
    for _ in range(count):
        if is_double:
            store(target, load(np.float64, source))
            store(target + size, load(np.float64, source + step))
            store(target + size + size, load(np.float64, source + step + step))
        else:
            store(target, load(np.float32, source))
            store(target + size, load(np.float32, source + step))
            store(target + size + size, load(np.float32, source + step + step))
        source += distance
        target += size + size + size


@kernel
def _copy(begin, end, given, copied, inner, outer_step, inner_step, step, is_double):
    """Copy the vectors at begin to end along the first axis.

    Parameters
    ----------
    begin, end : int
    given, copied : uint64
        Addresses of the first vector.
    inner : uint64
        Vectors along the second axis.
    outer_step, inner_step, step : uint64
        Bytes from a vector to the next along the first and second axis, and between its numbers.
    is_double : bool
        Whether numbers have 8 bytes, not 4.
    """
    row = np.uint64(24) if is_double else np.uint64(12)
    first, end, side = np.uint64(begin), np.uint64(end), np.uint64(_SIDE)
    if inner == np.uint64(1):
        _copy_run(
            given + first * outer_step,
            outer_step,
            step,
            copied + first * row,
            end - first,
            is_double,
        )
        return
    for top in range(first, end, side):
        bottom = min(top + side, end)
        for left in range(np.uint64(0), inner, side):
            for k in range(left + side, min(left + side + side, inner)):
                at = given + top * outer_step + k * inner_step
                prefetch(at)
                prefetch(at + _LINE)
            count = min(side, inner - left)
            for i in range(top, bottom):
                source = given + i * outer_step + left * inner_step
                target = copied + (i * inner + left) * row
                _copy_run(source, inner_step, step, target, count, is_double)
