"""The arrays of a grid, and the check that they are safe to traverse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.structures.grid.options import MAX_CELLS
from raystream.structures.saved import take

#: Most references in all lists together: offsets are uint32.
MAX_REFERENCES = 2**32 - 1

#: Most fine cells along an axis of a coarse cell.
MAX_FINE_AXIS = 1 << 10


class GridArrays(NamedTuple):
    """The lists of the cells, concatenated.

    Attributes
    ----------
    splits : ndarray of shape (C + 1,), uint32
        Cell i owns references splits[i] to splits[i + 1].
    references : ndarray of shape (R,), int32
        The prim_ids in each cell, in increasing order.
    """

    splits: NDArray[np.uint32]
    references: NDArray[np.int32]

    @classmethod
    def empty(cls, cell_count: int) -> GridArrays:
        """Make lists of cells without triangles."""
        return cls(np.zeros(cell_count + 1, np.uint32), np.zeros(0, np.int32))


class FineArrays(NamedTuple):
    """The second level: finer lattices within some cells.

    Attributes
    ----------
    cells : ndarray of shape (S,), int64
        The subdivided cells, in increasing order.
    counts : ndarray of shape (S, 3), int32
        Fine cells along each axis.
    lists : GridArrays
        Of the fine cells, one lattice after another.
    """

    cells: NDArray[np.int64]
    counts: NDArray[np.int32]
    lists: GridArrays

    @classmethod
    def none(cls) -> FineArrays:
        """Make a second level without lattices."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 3), np.int32), GridArrays.empty(0))

    @property
    def first_cells(self) -> NDArray[np.int64]:
        """Index of the first cell of each lattice in `lists`, shape (S + 1,), int64."""
        firsts = np.zeros(len(self.cells) + 1, np.int64)
        np.cumsum(self.counts.astype(np.int64).prod(axis=1), out=firsts[1:])
        return firsts

    def records(self) -> NDArray[np.int64]:
        """First cell and three counts of each lattice, for kernels: (S, 4), int64."""
        return np.column_stack([self.first_cells[:-1], self.counts.astype(np.int64)])

    def children(self, cell_count: int) -> NDArray[np.int32]:
        """The lattice of each cell, or -1; empty if there are no lattices."""
        if len(self.cells) == 0:
            return np.zeros(0, np.int32)
        children = np.full(cell_count, -1, np.int32)
        children[self.cells] = np.arange(len(self.cells), dtype=np.int32)
        return children


class GridAddresses(NamedTuple):
    """A grid as kernels take it; the caller keeps its arrays alive.

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
    children, records : uint64
        Addresses of `FineArrays.children` and `FineArrays.records`; 0 without a second level.
    fine_splits, fine_references : uint64
        Addresses of the second level's lists.
    """

    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]
    size: tuple[np.float32, np.float32, np.float32]
    counts: tuple[np.float32, np.float32, np.float32]
    splits: np.uint64
    references: np.uint64
    corners: np.uint64
    children: np.uint64
    records: np.uint64
    fine_splits: np.uint64
    fine_references: np.uint64


def check_lists(
    arrays: Mapping[str, NDArray[Any]],
    prefix: str,
    cell_count: int,
    solid: NDArray[np.bool_],
) -> GridArrays:
    """Check lists from a file: that no traversal reads out of bounds or never ends.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``splits`` and ``references``, see `GridArrays`.
    prefix : str
        Prefix of their names.
    cell_count : int
    solid : ndarray of shape (F,), bool
        Whether a triangle can be hit, and so may be listed.

    Returns
    -------
    GridArrays

    Raises
    ------
    ValueError
        If they are invalid.
    """
    splits = take(arrays, f"{prefix}splits", np.uint32, (None,))
    references = take(arrays, f"{prefix}references", np.int32, (None,))
    if len(splits) != cell_count + 1:
        raise ValueError(f"{len(splits):,} splits do not delimit {cell_count:,} cells")
    if splits[0] != 0 or splits[-1] != len(references):
        raise ValueError("the splits do not delimit the references")
    if (splits[:-1] > splits[1:]).any():
        raise ValueError("a cell's list ends before it begins")
    if not _are_valid(splits, references, solid):
        raise ValueError("a cell lists a triangle twice, or one that cannot be hit")
    return GridArrays(splits, references)


def check_fine(
    arrays: Mapping[str, NDArray[Any]], cell_count: int, solid: NDArray[np.bool_]
) -> FineArrays:
    """Check the second level from a file; see `check_lists`."""
    cells = take(arrays, "fine_cells", np.int64, (None,))
    counts = take(arrays, "fine_counts", np.int32, (None, 3))
    if len(cells) != len(counts) or (np.diff(cells) <= 0).any():
        raise ValueError("the subdivided cells are not in increasing order")
    if len(cells) and (cells[0] < 0 or cells[-1] >= cell_count):
        raise ValueError("a subdivided cell is out of range")
    if (counts < 1).any() or (counts > MAX_FINE_AXIS).any():
        raise ValueError("the resolution within a cell is out of range")
    if counts.astype(np.float64).prod(axis=1).sum() > MAX_CELLS:
        raise ValueError("too many cells of the second level")
    bare = FineArrays(cells, counts, GridArrays.empty(0))
    lists = check_lists(arrays, "fine_", int(bare.first_cells[-1]), solid)
    return FineArrays(cells, counts, lists)


@kernel
def _are_valid(splits, references, solid):
    """Whether each list is increasing, and holds solid triangles only."""
    for cell in range(len(splits) - 1):
        last = np.int64(-1)
        for row in range(np.int64(splits[cell]), np.int64(splits[cell + 1])):
            prim_id = np.int64(references[row])
            if prim_id <= last or prim_id >= len(solid) or not solid[prim_id]:
                return False
            last = prim_id
    return True
