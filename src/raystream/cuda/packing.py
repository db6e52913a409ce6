"""Packs rays on the device whose memory layout has no single stride from ray to ray."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.jit.constants import BYTES_64
from raystream.jit.cuda import DeviceView, StreamScope, gpu_kernel
from raystream.jit.simd import load, store

#: Most dimensions of an array after adjacent ones have been merged.
DIRECTIONS = 4


_SIZES = (np.uint64,) * DIRECTIONS


@gpu_kernel(lengths=_SIZES, strides=_SIZES)
def pack_row(i, at, lengths, strides, width, last, given_bytes, kept_bytes, to):
    """Copy one row for `pack`."""
    rest = i
    for k in range(DIRECTIONS):  # from the innermost
        at += rest % lengths[k] * strides[k]
        rest = rest // lengths[k]
    to += i * width * kept_bytes
    for _ in range(width):
        x = load(np.float64, at) if given_bytes == BYTES_64 else np.float64(load(np.float32, at))
        if kept_bytes == BYTES_64:
            store(to, x)
        else:
            store(to, np.float32(x))
        at += last
        to += kept_bytes


def pack(
    scope: StreamScope,
    name: str,
    view: DeviceView,
    runs: list[tuple[int, int]],
    last: int,
    count: int,
    dtype: np.dtype[Any],
) -> tuple[np.uint64, np.uint64]:
    """Copy an array to contiguous memory.

    Parameters
    ----------
    scope : StreamScope
    name : str
        Of the argument, for errors.
    view : DeviceView
        Vectors of shape S + (3,), or limits of shape S + (1,).
    runs : list of (int, int)
        Lengths and strides of S, broadcast, outermost first; empty if all rays share a value.
    last : int
        Stride of the last dimension.
    count : int
        Number of rays.
    dtype : dtype
        Of the copy, float32 or float64.

    Returns
    -------
    address, step : uint64

    Raises
    ------
    ValueError
        If more than four dimensions remain.
    CudaError
        If there is no memory.
    """
    if len(runs) > DIRECTIONS:
        raise ValueError(f"{name}: the array has too many different strides; make it contiguous")
    width = view.shape[-1]
    row_count = count if runs else 1
    made = scope.empty(name, (row_count, width), dtype)
    full = [*runs[::-1], *[(1, 0)] * (DIRECTIONS - len(runs))]
    arguments = (
        np.uint64(view.address),
        tuple(np.uint64(length) for length, _ in full),
        tuple(np.uint64(stride % 2**64) for _, stride in full),
        np.uint64(width),
        np.uint64(last % 2**64),
        np.uint64(view.dtype.itemsize),
        np.uint64(dtype.itemsize),
        made,
    )
    scope.launch(pack_row, row_count if count else 0, arguments)
    return made.address, np.uint64(width * dtype.itemsize if runs else 0)
