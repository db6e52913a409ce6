"""The second level of a grid: finer lattices inside the cells with many triangles.

Purcell 2002, section 5.1, names hierarchical grids as the answer to scenes whose detail is of
several sizes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.jit.threads import thread_count
from raystream.structures.grid.build import TooManyError, add_up, most_references
from raystream.structures.grid.lattice import LEAST_SIDE, Lattice, cube_side
from raystream.structures.grid.layout import MAX_FINE_AXIS, FineArrays, GridArrays
from raystream.structures.grid.options import MAX_CELLS
from raystream.structures.grid.overlap import range_along, spread

__all__ = ["refine"]

#: A cell with more triangles than this is divided.
_LONG_LIST = 6

#: Cells for each triangle of a cell that is divided.
_DENSITY = 2.5


def refine(triangles: Triangles, lattice: Lattice, lists: GridArrays) -> FineArrays:
    """Divide the cells of a grid that have many triangles.

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
        cells, counts = _divided(lattice, np.diff(lists.splits), density)
        if len(cells) == 0:
            return FineArrays.none()
        try:
            return _build(triangles, lattice, lists, cells, counts)
        except TooManyError:
            density /= 4.0


def _divided(
    lattice: Lattice, list_sizes: NDArray[np.uint32], density: float
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Which cells are divided, and into how many along each axis."""
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
        return _divided(lattice, list_sizes, density / 4.0)
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
    cell_count = int(firsts[-1])
    check_memory(cell_count * 8, f"levels: {cell_count:,} cells would", "choose 1")
    most = most_references(len(triangles.prim_ids))
    splits = np.zeros(cell_count + 1, np.uint32)
    nothing = np.empty(0, np.int32)
    whole = lattice, lists, cells, counts, firsts, triangles.corners
    total = _spread_all(*whole, splits[1:], nothing, most)
    check_memory(total * 4, f"levels: {total:,} references would", "choose 1")
    np.cumsum(splits, out=splits)
    references = np.empty(total, np.int32)
    _spread_all(*whole, splits[:-1].copy(), references, most)
    return FineArrays(cells, counts, GridArrays(splits, references))


def _spread_all(
    lattice: Lattice,
    lists: GridArrays,
    cells: NDArray[np.int64],
    counts: NDArray[np.int32],
    firsts: NDArray[np.int64],
    corners: NDArray[np.float32],
    cursors: NDArray[np.uint32],
    references: NDArray[np.int32],
    most: int,
) -> int:
    """Count the triangles of the finer cells, or write them; returns how many there are."""
    splits, prim_ids = lists

    def spread_some(begin: int, end: int) -> int:
        return int(
            _spread_cells(
                begin,
                end,
                lattice,
                splits,
                prim_ids,
                cells,
                counts,
                firsts,
                corners,
                cursors,
                references,
                most,
            )
        )

    chunk = min(256, max(1, -(-len(cells) // (8 * thread_count()))))
    return add_up(spread_some, len(cells), chunk, most)


@kernel
def _spread_cells(
    begin,
    end,
    lattice,
    splits,
    prim_ids,
    cells,
    counts,
    firsts,
    corners,
    cursors,
    references,
    most,
):
    """Count or write the triangles of the lattices begin to end; ends beyond `most`."""
    total = np.int64(0)
    is_fill = len(references) > 0
    cursor_at, reference_at = address(cursors), address(references)
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
        fine = Lattice(low, low, size, count, lattice.growth)
        at = cursor_at + np.uint64(4) * np.uint64(firsts[row])
        for place in range(np.uint64(splits[cell]), np.uint64(splits[cell + 1])):
            prim_id = np.uint64(prim_ids[place])
            first_x, last_x = range_along(fine, corners, prim_id, 0)
            first_y, last_y = range_along(fine, corners, prim_id, 1)
            first_z, last_z = range_along(fine, corners, prim_id, 2)
            first, last = (first_x, first_y, first_z), (last_x, last_y, last_z)
            total += spread(fine, corners, prim_id, first, last, at, reference_at, is_fill)
            # Asked here, since a list of equal triangles grows with the square of its length.
            if total > most:
                return total
    return total
