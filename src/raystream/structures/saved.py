"""Taking arrays from a file, checked by name, dtype, shape and content."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for
from raystream.kernels.leaf_block import BLOCK_SIZE

#: Lists of a call of their check: those of a hostile file may overlap, and take long.
_LISTS = 4096


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


def solid_mask(triangles: Triangles) -> NDArray[np.bool_]:
    """Whether each triangle of a scene can be hit."""
    solid = np.zeros(len(triangles), np.bool_)
    solid[triangles.prim_ids] = True
    return solid


def check_blocks(
    prim_ids: NDArray[np.int32],
    firsts: NDArray[Any],
    counts: NDArray[Any],
    solid: NDArray[np.bool_],
    cell: str,
) -> None:
    """Check the lists of triangles from a file, in blocks of four.

    Parameters
    ----------
    prim_ids : ndarray of shape (B, 4), int32
        The triangles of the blocks; -1 in unused places.
    firsts, counts : ndarray of shape (N,), integers
        First block and number of triangles of each list.
    solid : ndarray of shape (F,), bool
        Whether a triangle can be hit: then it must be listed, otherwise it must not.
    cell : str
        What has a list, for errors.

    Raises
    ------
    ValueError
        If they are invalid.
    """
    first, count = firsts.astype(np.int64), counts.astype(np.int64)
    if ((first < 0) | (count < 0) | (first - -count // BLOCK_SIZE > len(prim_ids))).any():
        raise ValueError(f"a {cell}'s list is out of range")
    missing = solid.copy()
    # In all blocks, also those in no list: corners are looked up for each.
    in_range = prim_ids.min(initial=-1) >= -1 and prim_ids.max(initial=-1) < len(solid)
    faults: list[int] = []

    def check_some(begin: int, end: int) -> None:
        if not _are_listed(begin, end, prim_ids, first, count, solid, missing):
            faults.append(begin)

    if in_range:
        parallel_for(check_some, len(first), _LISTS)
    if faults or not in_range:
        raise ValueError(f"a {cell} lists an invalid triangle, or too few")
    if missing.any():
        raise ValueError(f"a triangle of the scene is in no {cell}")


@kernel
def _are_listed(begin, end, prim_ids, firsts, counts, solid, missing):
    """Whether some lists hold solid triangles, and then -1; `missing` becomes false for these."""
    for row in range(begin, end):
        first, count = firsts[row], counts[row]
        for i in range(-(-count // BLOCK_SIZE) * BLOCK_SIZE):
            prim_id = np.int64(prim_ids[first + i // BLOCK_SIZE, i % BLOCK_SIZE])
            if i >= count:
                if prim_id != -1:
                    return False
                continue
            if prim_id < 0 or not solid[prim_id]:
                return False
            missing[prim_id] = False
    return True
