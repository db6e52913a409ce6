"""The grid as kernels: set up, traverse, intersect, shade (Purcell 2002, section 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.kernels.search import is_full, wants_any
from raystream.kernels.tally import LEAVES, STEPS, TESTS
from raystream.kernels.triangle_list import intersect_list
from raystream.machines.records import (
    INTERSECTING,
    TRAVERSING,
    add_count,
    count_step,
    end_state,
    found_by,
    prepared_ray,
)
from raystream.machines.steps.base import Steps, resume_search, traversal_kernels
from raystream.structures.grid.cells import (
    NO_CHILD,
    cell_list,
    cell_numbers,
    child_of,
    coarse_cells,
    fine_cells,
)
from raystream.structures.grid.dda import (
    WalkState,
    begin_walk,
    cell_end,
    prepare_walk,
    state_at,
    step_walk,
)
from raystream.structures.grid.structure import GridStructure
from raystream.structures.plane_distances import scene_interval

#: The traversal state of a ray. `outer` is the coarse cell whose lattice the ray traverses, up to
#: `t_end`; -1 in the coarse lattice. `row` to `end` are the references of its cell that are still
#: to be tested.
PLACE = np.dtype(
    [
        ("cell", np.int32),
        ("outer", np.int32),
        ("t_next", np.float32, 3),
        ("plane", np.float32, 3),
        ("t_after", np.float32, 3),
        ("t_in", np.float32),
        ("t_end", np.float32),
        ("row", np.uint32),
        ("end", np.uint32),
    ]
)

_COARSE = np.int32(-1)


class _Place(NamedTuple):
    """A record of `PLACE`, with a `WalkState`."""

    walk: object
    outer: object
    t_in: object
    t_end: object
    row: object
    end: object


@device
def _lattice(tree, outer):
    """The lattice that a ray traverses."""
    if outer == _COARSE:
        return coarse_cells(tree)
    return fine_cells(tree, outer, child_of(tree, outer))


@device
def _load(place):
    """A record of `PLACE` as a `_Place`."""
    state = WalkState(np.int64(place.cell), place.t_next, place.plane, place.t_after)
    return _Place(
        state,
        place.outer,
        place.t_in,
        place.t_end,
        np.uint64(place.row),
        np.uint64(place.end),
    )


@device
def _record(place):
    """A `_Place` as a record of `PLACE`."""
    walk = place.walk
    return (
        np.int32(walk.cell),
        place.outer,
        walk.t_next,
        walk.plane,
        walk.t_after,
        place.t_in,
        place.t_end,
        np.uint32(place.row),
        np.uint32(place.end),
    )


@device
def _is_over(place, t_far):
    """Whether no hit beyond a ray's cell can change the result."""
    return t_far < min(cell_end(place.walk), place.t_end)


@device
def _next_cell(tree, ray, place):
    """The next cell along a ray."""
    t_out = min(cell_end(place.walk), place.t_end)
    if t_out < place.t_end or place.outer == _COARSE:
        walk = prepare_walk(_lattice(tree, place.outer), ray)
        return _Place(
            step_walk(walk, place.walk), place.outer, t_out, place.t_end, ZERO_U64, ZERO_U64
        )
    # Leave the lattice of a coarse cell for the next coarse cell.
    coarse = coarse_cells(tree)
    walk = prepare_walk(coarse, ray)
    i, j, k = cell_numbers(tree, place.outer)
    state = step_walk(walk, state_at(coarse, walk, i, j, k))
    return _Place(state, _COARSE, t_out, INF_F32, ZERO_U64, ZERO_U64)


def set_up(ray, wanted, tree, query, kernel):
    """Find the cell in which a ray begins."""
    count_step(query, wanted, kernel, STEPS, ZERO_U64)
    line = prepared_ray(ray, query)
    t_in, t_far = scene_interval(tree, line, ray.t_min, ray.t_max)
    is_active = tree.splits != NULL and t_in <= t_far
    if not is_active:
        t_in = t_far = np.float32(0.0)
    coarse = coarse_cells(tree)
    _, walk = begin_walk(coarse, line, t_in)
    place = _Place(walk, _COARSE, t_in, INF_F32, ZERO_U64, ZERO_U64)
    state = TRAVERSING if is_active else end_state(ZERO_U64, query)
    return (np.uint32(0), t_far), _record(place), state


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Find the triangles of a ray's cell, or the next cell if it is empty."""
    at = _load(place)
    line = prepared_ray(ray, query)
    state = TRAVERSING
    for _ in range(query.steps):
        count_step(query, wanted, kernel, STEPS, ONE_U64)
        lattice = _lattice(tree, at.outer)
        row, end = cell_list(lattice.splits, at.walk.cell)
        if row != end:
            child = child_of(tree, at.walk.cell) if at.outer == _COARSE else NO_CHILD
            if child == NO_CHILD:
                add_count(query, wanted, LEAVES, ONE_U64)
                at = _Place(at.walk, at.outer, at.t_in, at.t_end, row, end)
                state = INTERSECTING
                break
            fine = fine_cells(tree, at.walk.cell, child)
            _, walk = begin_walk(fine, line, at.t_in)
            outer = np.int32(at.walk.cell)
            at = _Place(walk, outer, at.t_in, cell_end(at.walk), ZERO_U64, ZERO_U64)
        else:
            if _is_over(at, found.t_far):
                state = end_state(np.uint64(found.count), query)
                break
            at = _next_cell(tree, line, at)
    return _record(at), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a triangle of a ray's cell; after the last one, step to the next cell."""
    at = _load(place)
    line = prepared_ray(ray, query)
    search = resume_search(query.hits, ray, wanted, found, query)
    references = _lattice(tree, at.outer).references
    t_out = INF_F32 if wants_any(search) else min(cell_end(at.walk), at.t_end)
    row, state = at.row, INTERSECTING
    for _ in range(query.tests):
        count_step(query, wanted, kernel, TESTS, ONE_U64)
        search = intersect_list(
            references, tree.corners, row, row + ONE_U64, line, search, at.t_in, t_out
        )
        row += ONE_U64
        if is_full(search) or (row == at.end and _is_over(at, search.t_far)):
            state = end_state(search.hit_count, query)
            break
        if row == at.end:
            at = _next_cell(tree, line, at)
            state = TRAVERSING
            break
    place = _Place(at.walk, at.outer, at.t_in, at.t_end, row, at.end)
    return found_by(search), _record(place), state


_KERNELS = traversal_kernels(set_up, traverse, intersect)


def steps(grid: GridStructure) -> Steps:
    """The steps of a traversal of a grid, of one level or two."""
    return Steps(_KERNELS, PLACE, grid.view)
