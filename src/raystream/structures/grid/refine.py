"""The second level of a grid: finer lattices within the cells that have many triangles.

Purcell 2002, section 5.1, names hierarchical grids as the answer to scenes whose detail is of
several sizes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.jit.threads import thread_count
from raystream.structures.grid.build import (
    ListOutput,
    TooManyError,
    count_and_fill,
    parallel_count,
    reference_limit,
)
from raystream.structures.grid.lattice import LEAST_SIDE, Lattice, cube_side
from raystream.structures.grid.layout import MAX_FINE_AXIS, FineArrays, GridArrays
from raystream.structures.grid.options import MAX_CELLS
from raystream.structures.grid.overlap import ListWriter, cell_ranges, each_cell, list_triangle

#: Cells with more triangles than this are subdivided.
_LONG_LIST = 6

#: Fine cells per triangle of a subdivided cell.
_DENSITY = 2.5


def refine(triangles: Triangles, lattice: Lattice, lists: GridArrays) -> FineArrays:
    """Subdivide the cells of a grid that have many triangles.

    Parameters
    ----------
    triangles : Triangles
    lattice : Lattice
    lists : GridArrays

    Returns
    -------
    FineArrays
        The same for any number of threads.

    Raises
    ------
    MemoryError
        If there is not enough memory.
    """
    density = _DENSITY
    while True:
        cells, counts = _subdivided(lattice, np.diff(lists.splits), density)
        if len(cells) == 0:
            return FineArrays.none()
        try:
            return _build(triangles, lattice, lists, cells, counts)
        except TooManyError:
            density /= 4.0


def _subdivided(
    lattice: Lattice, list_sizes: NDArray[np.uint32], density: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The cells to subdivide, and their resolutions."""
    cells = np.flatnonzero(list_sizes > _LONG_LIST)
    if len(cells) == 0:
        return cells, np.zeros((0, 3), np.int32)
    size = np.array(lattice.size)
    wanted = np.maximum(1.0, density * list_sizes[cells].astype(np.float64))
    side = np.maximum(cube_side(size, wanted), LEAST_SIDE * lattice.growth)
    counts = np.clip(np.rint(size / side[:, None]), 1, MAX_FINE_AXIS).astype(np.int32)
    several = counts.max(axis=1) > 1
    cells, counts = cells[several], counts[several]
    if counts.astype(np.float64).prod(axis=1).sum() > MAX_CELLS:
        return _subdivided(lattice, list_sizes, density / 4.0)
    return cells.astype(np.int64), counts


def _build(
    triangles: Triangles,
    lattice: Lattice,
    lists: GridArrays,
    cells: NDArray[np.int64],
    counts: NDArray[np.int32],
) -> FineArrays:
    fine = FineArrays(cells, counts, GridArrays.empty(0))
    firsts = fine.first_cells
    limit = reference_limit(len(triangles.prim_ids))
    chunk = min(256, max(1, -(-len(cells) // (8 * thread_count()))))

    def list_all(output: ListOutput) -> int:
        """Count the triangles of the finer cells, or write them; returns their number."""

        def list_some(begin: int, end: int) -> int:
            given = lattice, lists, cells, counts, firsts, triangles.corners, output
            return int(_list_cells(begin, end, *given))

        return parallel_count(list_some, len(cells), chunk, limit)

    filled = count_and_fill(int(firsts[-1]), limit, list_all, "levels", "choose 1")
    return FineArrays(cells, counts, filled)


@kernel
def _list_cells(begin, end, lattice, lists, cells, counts, firsts, corners, output):
    """Count or write the triangles of the lattices begin to end; stops beyond the limit."""
    total, limit = np.int64(0), output.limit
    is_fill = len(output.references) > 0
    position_at, reference_at = address(output.positions), address(output.references)
    splits, prim_ids = lists.splits, lists.references
    for row in range(np.uint64(begin), np.uint64(end)):
        cell = cells[row]
        nx, ny = lattice.counts[0], lattice.counts[1]
        i, j, k = cell % nx, cell // nx % ny, cell // (nx * ny)
        low = (
            lattice.low[0] + lattice.size[0] * i,
            lattice.low[1] + lattice.size[1] * j,
            lattice.low[2] + lattice.size[2] * k,
        )
        count = (np.int64(counts[row, 0]), np.int64(counts[row, 1]), np.int64(counts[row, 2]))
        size = (
            lattice.size[0] / count[0],
            lattice.size[1] / count[1],
            lattice.size[2] / count[2],
        )
        fine = Lattice(low, low, size, count, lattice.growth, lattice.is_exact)
        at = position_at + np.uint64(4) * np.uint64(firsts[row])
        writer = ListWriter(at, reference_at, is_fill)
        for place in range(np.uint64(splits[cell]), np.uint64(splits[cell + 1])):
            prim_id = np.uint64(prim_ids[place])
            first, last = cell_ranges(fine, corners, prim_id)
            total += each_cell(fine, corners, prim_id, first, last, list_triangle, writer)
            # Checked here, since a list of equal triangles grows with the square of its length.
            if total > limit:
                return total
    return total
