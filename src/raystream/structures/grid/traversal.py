"""Grid traversal: the walk through the cells along a ray."""

from __future__ import annotations

from raystream.jit.constants import INF_F32, NULL, ONE_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.kernels.search import is_full, wants_any
from raystream.kernels.tally import LEAVES, STEPS, add_to
from raystream.kernels.triangle_list import intersect_list
from raystream.structures.grid.cells import NO_CHILD, cell_list, child_of, coarse_cells, fine_cells
from raystream.structures.grid.dda import begin_walk, cell_end, step_walk
from raystream.structures.plane_distances import scene_interval


def _cell_walk(search_cell):
    """Make the walk through the cells of a lattice.

    Parameters
    ----------
    search_cell : device function
        ``search_cell(grid, cells, ray, cell, rows, search, t_in, t_out, t_last) -> search`` offers
        the hits in a cell to a search; `rows` are begin and end of its list.

    Returns
    -------
    device function
        ``walk_cells(grid, cells, ray, search, t_in, t_end, t_last) -> search`` walks from t_in to
        t_end. No hit is wanted beyond t_last.
    """

    @device
    def walk_cells(grid, cells, ray, search, t_in, t_end, t_last):
        walk, state = begin_walk(cells, ray, t_in)
        while True:
            t_out = min(cell_end(state), t_end)
            begin, end = cell_list(cells.splits, state.cell)
            add_to(search.counters, STEPS, ONE_U64)
            # A hit at the cell's end is in the next cell, and may tie with the one at t_far.
            t_far = min(search.t_far, t_last)
            while begin == end and t_out <= t_far and t_out < t_end:
                state = step_walk(walk, state)
                t_in, t_out = t_out, min(cell_end(state), t_end)
                begin, end = cell_list(cells.splits, state.cell)
                add_to(search.counters, STEPS, ONE_U64)
            rows = begin, end
            search = search_cell(grid, cells, ray, state.cell, rows, search, t_in, t_out, t_last)
            if is_full(search) or min(search.t_far, t_last) < t_out or t_out >= t_end:
                return search
            state = step_walk(walk, state)
            t_in = t_out

    return walk_cells


@device
def _search_cell(grid, cells, ray, cell, rows, search, t_in, t_out, t_last):
    """Test the triangles of a cell; an any-hit search accepts hits beyond the cell, too."""
    begin, end = rows
    if begin != end:
        add_to(search.counters, LEAVES, ONE_U64)
    t_out = INF_F32 if wants_any(search) else t_out
    return intersect_list(cells.references, grid.corners, begin, end, ray, search, t_in, t_out)


_walk_fine = _cell_walk(_search_cell)


@device_call
def _search_lattice(grid, cells, ray, search, t_in, t_out, t_last):
    """Search the finer lattice within a cell."""
    no_inline()
    return _walk_fine(grid, cells, ray, search, t_in, t_out, t_last)


@device
def _search_coarse_cell(grid, cells, ray, cell, rows, search, t_in, t_out, t_last):
    """Search a cell of the first level, which may be subdivided."""
    child = child_of(grid, cell)
    if child != NO_CHILD:
        within = fine_cells(grid, cell, child)
        return _search_lattice(grid, within, ray, search, t_in, t_out, t_last)
    return _search_cell(grid, cells, ray, cell, rows, search, t_in, t_out, t_last)


_walk_coarse = _cell_walk(_search_coarse_cell)


@device
def traverse(grid, ray, search, stack):
    """Visit the cells along a ray; see `kernels.queries.ray_queries` for the arguments."""
    t_in, t_last = scene_interval(grid, ray, search.t_min, search.t_far)
    if grid.splits == NULL or not (t_in <= t_last):
        return search
    return _walk_coarse(grid, coarse_cells(grid), ray, search, t_in, INF_F32, t_last)
