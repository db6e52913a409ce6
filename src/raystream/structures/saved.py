"""Taking arrays from a file, checked by name, dtype, shape and content."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK_SIZE


def take(
    arrays: Mapping[str, NDArray[Any]], name: str, dtype: Any, shape: tuple[int | None, ...]
) -> NDArray[Any]:
    """Take an array from a file.

    Parameters
    ----------
    arrays : mapping of str to ndarray
    name : str
    dtype : dtype
    shape : tuple of int or None
        Expected lengths; None for any.

    Returns
    -------
    ndarray
        Contiguous.

    Raises
    ------
    ValueError
        If it is missing, or of another dtype or shape.
    """
    array = arrays.get(name)
    if array is None:
        raise ValueError(f"array {name!r} is missing")
    fits = array.ndim == len(shape) and all(
        wanted is None or length == wanted
        for length, wanted in zip(array.shape, shape, strict=True)
    )
    if array.dtype != dtype or not fits:
        raise ValueError(f"array {name!r} has dtype {array.dtype} and shape {array.shape}")
    return np.ascontiguousarray(array).reshape(array.shape)  # a scalar has become 1D


@device
def are_listed(prim_ids, first, count, solid, wanted):
    """Whether blocks list `count` triangles that can be hit, and -1 in their unused places.

    Parameters
    ----------
    prim_ids : ndarray of shape (B, 4), int32
    first, count : int64
        First block, and number of triangles; all blocks are in `prim_ids`.
    solid : ndarray of shape (F,), bool
        Whether a triangle can be hit.
    wanted : ndarray of shape (F,), bool
        Becomes False for those listed.
    """
    for i in range(-(-count // BLOCK_SIZE) * BLOCK_SIZE):
        prim_id = np.int64(prim_ids[first + i // BLOCK_SIZE, i % BLOCK_SIZE])
        if i >= count:
            if prim_id != -1:
                return False
            continue
        if prim_id < 0 or prim_id >= len(solid) or not solid[prim_id]:
            return False
        wanted[prim_id] = False
    return True
