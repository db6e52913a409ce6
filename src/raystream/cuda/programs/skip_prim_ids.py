"""Triangles that rays skip (`skip_prim_ids`), in GPU memory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from raystream.core.rays import is_on_gpu
from raystream.cuda.programs.steps import narrow_ids
from raystream.jit.cuda import DeviceView, StreamScope, view_of
from raystream.programs.rows import SkipsAt, as_skips

_TYPES = (np.dtype(np.int32), np.dtype(np.int64))


def place_skips(
    scope: StreamScope, values: Any, shape: tuple[int, ...], triangle_count: int
) -> SkipsAt | None:
    """Copy `skip_prim_ids` to a device, or view it there.

    Parameters
    ----------
    scope : StreamScope
    values : array_like or None
        On the host as for `as_skips`, or on the device as int32 or int64 in C order.
    shape : tuple of int
        Of the rays.
    triangle_count : int

    Raises
    ------
    ValueError, TypeError
        As `as_skips`. Values on the device are not checked, because the host would have to
        wait; those that are not a prim_id match no triangle.
    """
    if values is None:
        return None
    if not is_on_gpu(values):
        array = as_skips(values, shape, triangle_count)
        scope.keep(array)
        placed = scope.placed("skip_prim_ids", array)
        return SkipsAt(placed.address, np.uint64(array.shape[1]))
    view = view_of(scope, "skip_prim_ids", values)
    if view.dtype not in _TYPES:
        raise TypeError(f"skip_prim_ids: expected int32 or int64 on a GPU, got {view.dtype}")
    if view.shape != shape and view.shape[:-1] != shape:
        raise ValueError(
            f"skip_prim_ids: expected the rays' shape {shape}, or {shape} + (k,), got {view.shape}"
        )
    count = math.prod(view.shape)
    if not is_packed(view):
        raise TypeError(
            "skip_prim_ids: the array on the GPU is not in C order, or not aligned; copy it"
        )
    address = np.uint64(view.address)
    if view.dtype.itemsize == 8:
        narrowed = scope.empty("skip_prim_ids", count, np.int32)
        scope.launch(narrow_ids, count, (address, narrowed))
        address = narrowed.address
    return SkipsAt(address, np.uint64(1 if view.shape == shape else view.shape[-1]))


def is_packed(view: DeviceView) -> bool:
    """Whether an array is aligned, contiguous and in C order."""
    if view.address % view.dtype.alignment:
        return False
    step = view.dtype.itemsize
    for length, stride in zip(view.shape[::-1], view.strides[::-1], strict=True):
        if length > 1 and stride != step:
            return False
        step *= length
    return True
