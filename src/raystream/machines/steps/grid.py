"""The grid as kernels: set up, traverse, intersect, shade (Purcell 2002, section 3.1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import fma, load
from raystream.kernels.tally import LEAVES, STEPS, TESTS
from raystream.machines.records import RayState, end_of, note, ray_of, tick, wants_any
from raystream.machines.steps.base import StepKernel, Steps, with_shade
from raystream.structures.grid import Grid
from raystream.structures.grid.dda import (
    WalkState,
    cell_end,
    set_up_walk,
    step_walk,
    walk_from,
    walk_through,
)
from raystream.structures.grid.traversal import cell_list, enter_grid, intersect_list

__all__ = ["steps"]

#: Where a ray is in a grid. `outer` is the coarse cell that it walks through the lattice of,
#: which it leaves at `t_end`; -1 where it walks through coarse cells. `row` to `end` are the
#: references of its cell that are still to be tested.
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

_TRAVERSING = np.uint8(RayState.TRAVERSING)
_INTERSECTING = np.uint8(RayState.INTERSECTING)
_DONE = np.uint8(RayState.DONE)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # a number's four bytes, as a shift
_INF = np.float32(np.inf)
_COARSE = np.int32(-1)
_NO_CHILD = np.int32(-1)

#: Bytes of a row of `FineArrays.records`.
_RECORD = np.uint64(32)


class _Lattice(NamedTuple):
    """What walks need of a lattice, and its lists."""

    low: object
    size: object
    counts: object
    splits: object
    references: object


class _Place(NamedTuple):
    """A record of `PLACE` with the walk as its functions take it."""

    walk: object
    outer: object
    t_in: object
    t_end: object
    row: object
    end: object


@device
def _coarse(tree):
    return _Lattice(tree.low, tree.size, tree.counts, tree.splits, tree.references)


@device
def _child_of(tree, cell):
    """Number of the lattice within a coarse cell."""
    if tree.children == _NONE:
        return _NO_CHILD
    return load(np.int32, tree.children + (np.uint64(cell) << _WORD))


@device
def _where(tree, cell):
    """The numbers of a coarse cell along the axes."""
    nx, ny = np.int64(tree.counts[0]), np.int64(tree.counts[1])
    rest = np.int64(cell)
    return np.float32(rest % nx), np.float32(rest // nx % ny), np.float32(rest // (nx * ny))


@device
def _fine(tree, cell, child):
    """The lattice within a coarse cell."""
    record = tree.records + np.uint64(child) * _RECORD
    first = load(np.int64, record)
    counts = (
        np.float32(load(np.int64, record + np.uint64(8))),
        np.float32(load(np.int64, record + np.uint64(16))),
        np.float32(load(np.int64, record + np.uint64(24))),
    )
    i, j, k = _where(tree, cell)
    low = (
        fma(i, tree.size[0], tree.low[0]),
        fma(j, tree.size[1], tree.low[1]),
        fma(k, tree.size[2], tree.low[2]),
    )
    size = (tree.size[0] / counts[0], tree.size[1] / counts[1], tree.size[2] / counts[2])
    splits = tree.fine_splits + (np.uint64(first) << _WORD)
    return _Lattice(low, size, counts, splits, tree.fine_references)


@device
def _lattice(tree, outer):
    """The lattice that a ray walks through."""
    return _coarse(tree) if outer == _COARSE else _fine(tree, outer, _child_of(tree, outer))


@device
def _given(place):
    """A record of the stream of places as a `_Place`."""
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
def _is_over(place, count, t_far, wanted, query):
    """Whether a ray that leaves its cell has all that it wants."""
    is_enough = not query.keep and count == wanted.capacity
    return t_far < min(cell_end(place.walk), place.t_end) or is_enough


@device
def _next_cell(tree, ray, place):
    """Where a ray is after its cell."""
    t_out = min(cell_end(place.walk), place.t_end)
    if t_out < place.t_end or place.outer == _COARSE:
        walk = walk_through(_lattice(tree, place.outer), ray)
        return _Place(step_walk(walk, place.walk), place.outer, t_out, place.t_end, _NONE, _NONE)
    # Out of the lattice within a coarse cell, into the coarse cell after it.
    coarse = _coarse(tree)
    walk = walk_through(coarse, ray)
    i, j, k = _where(tree, place.outer)
    state = step_walk(walk, walk_from(coarse, walk, i, j, k))
    return _Place(state, _COARSE, t_out, _INF, _NONE, _NONE)


def set_up(ray, wanted, tree, query, kernel):
    """Find the cell in which a ray begins."""
    tick(query, wanted, kernel, STEPS, _NONE)
    line = ray_of(ray, query)
    t_in, t_far = enter_grid(tree, line, ray.t_min, ray.t_max)
    is_active = tree.splits != _NONE and t_in <= t_far
    if not is_active:
        t_in = t_far = np.float32(0.0)
    coarse = _coarse(tree)
    _, state = set_up_walk(coarse, line, t_in)
    place = _Place(state, _COARSE, t_in, _INF, _NONE, _NONE)
    return (np.uint32(0), t_far), _record(place), _TRAVERSING if is_active else _DONE


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Look at the cell that a ray is in; go on to the next one if it is empty."""
    at = _given(place)
    line = ray_of(ray, query)
    state = _TRAVERSING
    count = np.uint64(found.count)
    for _ in range(query.steps):
        tick(query, wanted, kernel, STEPS, _ONE)
        lattice = _lattice(tree, at.outer)
        row, end = cell_list(lattice.splits, at.walk.cell)
        if row != end:
            child = _child_of(tree, at.walk.cell) if at.outer == _COARSE else _NO_CHILD
            if child == _NO_CHILD:
                note(query, wanted, LEAVES, _ONE)
                at = _Place(at.walk, at.outer, at.t_in, at.t_end, row, end)
                state = _INTERSECTING
                break
            fine = _fine(tree, at.walk.cell, child)
            _, walk = set_up_walk(fine, line, at.t_in)
            outer = np.int32(at.walk.cell)
            at = _Place(walk, outer, at.t_in, cell_end(at.walk), _NONE, _NONE)
        else:
            if _is_over(at, count, found.t_far, wanted, query):
                state = end_of(count, query)
                break
            at = _next_cell(tree, line, at)
    return _record(at), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a triangle of the cell that a ray is in; go on to the next cell after the last."""
    at = _given(place)
    line = ray_of(ray, query)
    references = _lattice(tree, at.outer).references
    t_out = min(cell_end(at.walk), at.t_end)
    row, count, t_far = at.row, np.uint64(found.count), found.t_far
    state = _INTERSECTING
    for _ in range(query.tests):
        tick(query, wanted, kernel, TESTS, _ONE)
        count, t_far = intersect_list(
            references,
            tree.corners,
            line,
            row,
            row + _ONE,
            at.t_in,
            _INF if wants_any(wanted, query) else t_out,
            t_far,
            query.surfaces,
            query.keep,
            count,
            wanted.capacity,
            wanted.first,
            query.hits,
            None,
        )
        row += _ONE
        is_enough = not query.keep and count == wanted.capacity
        if row == at.end or is_enough:
            if _is_over(at, count, t_far, wanted, query):
                state = end_of(count, query)
            else:
                at = _next_cell(tree, line, at)
                state = _TRAVERSING
            break
    place = _Place(at.walk, at.outer, at.t_in, at.t_end, row, at.end)
    return (np.uint32(count), t_far), _record(place), state


_KERNELS = with_shade(
    StepKernel("set up", RayState.STARTING, device(set_up), ("found", "place")),
    StepKernel("traverse", RayState.TRAVERSING, device(traverse), ("place",), "steps"),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
)


def steps(grid: Grid) -> Steps:
    """The steps of a grid's traversal, of one level or two."""
    return Steps(_KERNELS, PLACE, grid.arrays)
