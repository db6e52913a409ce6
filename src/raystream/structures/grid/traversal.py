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


@device
def _visit_cell(grid, cells, ray, begin, end, search, t_in, t_out):
    """Test the triangles of a cell; an any-hit search accepts hits beyond the cell, too."""
    if begin != end:
        add_to(search.counters, LEAVES, ONE_U64)
    t_out = INF_F32 if wants_any(search) else t_out
    return intersect_list(cells.references, grid.corners, begin, end, ray, search, t_in, t_out)


@device_call
def _visit_fine(grid, cells, ray, search, t_in, t_end, t_last):
    """Visit the fine cells of a cell, from t_in to t_end; none beyond t_last."""
    no_inline()
    walk, state = begin_walk(cells, ray, t_in)
    while True:
        t_out = min(cell_end(state), t_end)
        begin, end = cell_list(cells.splits, state.cell)
        add_to(search.counters, STEPS, ONE_U64)
        t_far = min(search.t_far, t_last)
        while begin == end and t_out <= t_far and t_out < t_end:
            state = step_walk(walk, state)
            t_in, t_out = t_out, min(cell_end(state), t_end)
            begin, end = cell_list(cells.splits, state.cell)
            add_to(search.counters, STEPS, ONE_U64)
        search = _visit_cell(grid, cells, ray, begin, end, search, t_in, t_out)
        if is_full(search) or min(search.t_far, t_last) < t_out or t_out >= t_end:
            return search
        state = step_walk(walk, state)
        t_in = t_out


@device
def traverse(grid, ray, search, stack):
    """Visit the cells along a ray; see `kernels.queries.ray_queries` for the arguments."""
    t_in, t_last = scene_interval(grid, ray, search.t_min, search.t_far)
    if grid.splits == NULL or not (t_in <= t_last):
        return search
    cells = coarse_cells(grid)
    walk, state = begin_walk(cells, ray, t_in)
    while True:
        t_out = cell_end(state)
        begin, end = cell_list(cells.splits, state.cell)
        add_to(search.counters, STEPS, ONE_U64)
        # A hit at the cell's end is in the next cell, and may tie with the one at t_far.
        t_far = min(search.t_far, t_last)
        while begin == end and t_out <= t_far:
            state = step_walk(walk, state)
            t_in, t_out = t_out, cell_end(state)
            begin, end = cell_list(cells.splits, state.cell)
            add_to(search.counters, STEPS, ONE_U64)
        child = child_of(grid, state.cell)
        if child != NO_CHILD:
            within = fine_cells(grid, state.cell, child)
            search = _visit_fine(grid, within, ray, search, t_in, t_out, t_last)
        else:
            search = _visit_cell(grid, cells, ray, begin, end, search, t_in, t_out)
        if is_full(search) or min(search.t_far, t_last) < t_out:
            return search
        state = step_walk(walk, state)
        t_in = t_out
