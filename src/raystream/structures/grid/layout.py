"""The arrays of a grid, and the check that they are safe to traverse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.structures.grid.lattice import Lattice

__all__ = ["MAX_REFERENCES", "GridAddresses", "GridArrays", "check_lists"]

#: References in all lists together: their number is uint32.
MAX_REFERENCES = 2**32 - 1


class GridArrays(NamedTuple):
    """The lists of the cells, one after another.

    Attributes
    ----------
    splits : ndarray of shape (C + 1,), uint32
        Cell i owns references splits[i] to splits[i + 1].
    references : ndarray of shape (R,), int32
        The prim_ids in each cell, in increasing order.
    """

    splits: NDArray[np.uint32]
    references: NDArray[np.int32]


class GridAddresses(NamedTuple):
    """A grid as kernels take it; whoever calls one keeps its arrays alive.

    Attributes
    ----------
    low, high, size : tuple of three float32
        See `Lattice`.
    counts : tuple of three float32
        Cells along each axis.
    splits, references : uint64
        Addresses of `GridArrays`; 0 for a grid without triangles.
    corners : uint64
        Address of the triangles' corners, by prim_id.
    """

    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]
    size: tuple[np.float32, np.float32, np.float32]
    counts: tuple[np.float32, np.float32, np.float32]
    splits: np.uint64
    references: np.uint64
    corners: np.uint64

    @classmethod
    def of(
        cls, lattice: Lattice, arrays: GridArrays, corners: NDArray[np.float32]
    ) -> GridAddresses:
        """Where a grid is."""
        vectors = [
            tuple(np.float32(number) for number in vector)
            for vector in (lattice.low, lattice.high, lattice.size, lattice.counts)
        ]
        addresses = [np.uint64(array.ctypes.data) for array in (*arrays, corners)]
        if len(arrays.references) == 0:
            addresses[0] = np.uint64(0)
        return cls(*vectors, *addresses)


def check_lists(
    arrays: Mapping[str, NDArray[Any]],
    cell_count: int,
    solid_ids: NDArray[np.int32],
    triangle_count: int,
) -> GridArrays:
    """Check the lists from a file: no traversal of them may read out of bounds or not end.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``splits`` and ``references``, see `GridArrays`.
    cell_count : int
    solid_ids : ndarray of shape (A,), int32
        The triangles that the cells must hold.
    triangle_count : int
        Triangles of the scene.

    Returns
    -------
    GridArrays

    Raises
    ------
    ValueError
        What is wrong.
    """
    splits = _array(arrays, "splits", np.uint32)
    references = _array(arrays, "references", np.int32)
    if len(splits) != cell_count + 1:
        raise ValueError(f"{len(splits):,} splits do not delimit {cell_count:,} cells")
    if splits[0] != 0 or splits[-1] != len(references):
        raise ValueError("the cells' lists are not those of the file")
    if (splits[:-1] > splits[1:]).any():
        raise ValueError("a cell's list ends before it begins")
    wanted = np.zeros(triangle_count, np.bool_)
    wanted[solid_ids] = True
    if not _are_good(splits, references, wanted):
        raise ValueError("a cell lists a triangle twice, or one that cannot be hit")
    found = np.zeros(triangle_count, np.bool_)
    found[references] = True
    if not np.array_equal(found, wanted):
        raise ValueError("its cells do not hold every triangle")
    return GridArrays(splits, references)


def _array(arrays: Mapping[str, NDArray[Any]], name: str, dtype: Any) -> NDArray[Any]:
    if name not in arrays:
        raise ValueError(f"array {name!r} is missing")
    array = arrays[name]
    if array.dtype != dtype or array.ndim != 1:
        raise ValueError(f"array {name!r} has dtype {array.dtype} and shape {array.shape}")
    return np.ascontiguousarray(array)


@kernel
def _are_good(splits, references, solid):
    """Whether each list increases, and holds solid triangles only."""
    for cell in range(len(splits) - 1):
        last = np.int64(-1)
        for row in range(np.int64(splits[cell]), np.int64(splits[cell + 1])):
            prim_id = np.int64(references[row])
            if prim_id <= last or prim_id >= len(solid) or not solid[prim_id]:
                return False
            last = prim_id
    return True
