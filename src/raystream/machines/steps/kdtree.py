"""The kd-tree as Foley's kernels: Initialize, Down, Leaf, Intersect, Continue, Up.

Foley 2005, section 3.3. Intersect takes a block of up to four triangles at a time.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block
from raystream.kernels.search import is_full
from raystream.kernels.tally import (
    BACKTRACK_STEPS,
    BACKTRACKS,
    LEAVES,
    RESTARTS,
    STEPS,
    TESTS,
)
from raystream.machines.records import RayState, end_of, note, ray_of, tick
from raystream.machines.steps.base import StepKernel, Steps, resumed, with_shade
from raystream.structures.kdtree import traversal, traversals
from raystream.structures.kdtree.nodes import is_leaf, leaf_of
from raystream.structures.kdtree.state import (
    SHORT_STACK,
    SHORT_STACK_BYTES,
    STACK,
    STACK_BYTES,
    KdState,
    split_ray,
)
from raystream.structures.kdtree.structure import KdTreeStructure

__all__ = ["steps"]

#: Where a ray's search is: `KdState`, and the blocks of its leaf that are still to be tested:
#: the offset of the next one, and how many triangles it and those after it hold.
PLACE = np.dtype(
    [
        ("node", np.uint32),
        ("t_in", np.float32),
        ("t_out", np.float32),
        ("t_end", np.float32),
        ("top", np.uint32),
        ("block", np.uint64),
        ("left", np.uint32),
    ]
)

#: Bytes of a ray's stack, for traversals that have one.
_STACKS = {int(STACK): STACK_BYTES, int(SHORT_STACK): SHORT_STACK_BYTES}

_DONE = np.uint8(RayState.DONE)
_TRAVERSING = np.uint8(RayState.TRAVERSING)
_AT_LEAF = np.uint8(RayState.AT_LEAF)
_INTERSECTING = np.uint8(RayState.INTERSECTING)
_LEAVING = np.uint8(RayState.LEAVING)
_CLIMBING = np.uint8(RayState.CLIMBING)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_LANES = np.uint64(4)


@device
def _search(place):
    """A record of `PLACE` as a `KdState`."""
    node, top = np.uint64(place.node), np.uint64(place.top)
    return KdState(node, place.t_in, place.t_out, place.t_end, top, False)


@device
def _record(state, block, left):
    """A `KdState`, and blocks, as a record of `PLACE`."""
    node, top = np.uint32(state.node), np.uint32(state.top)
    return (node, state.t_in, state.t_out, state.t_end, top, block, np.uint32(left))


@device
def _stack_of(wanted, query):
    return query.stacks + np.uint64(wanted.number) * query.stack_bytes


@device
def _downward(tree, state):
    """What a ray does next at a node."""
    return _AT_LEAF if is_leaf(tree, state.node) else _TRAVERSING


def initialize(ray, wanted, tree, query, kernel):
    """Begin at the root."""
    tick(query, wanted, kernel, STEPS, _NONE)
    is_active, state = traversal.initialize(tree, ray_of(ray, query), ray.t_min, ray.t_max)
    status = _DONE
    if is_active:
        status = _downward(tree, state)
    return (np.uint32(0), ray.t_max), _record(state, _NONE, _NONE), status


def descend(ray, wanted, place, tree, query, kernel):
    """Go to a child."""
    line, stack = split_ray(ray_of(ray, query)), _stack_of(wanted, query)
    state = _search(place)
    status = _TRAVERSING
    for _ in range(query.steps):
        tick(query, wanted, kernel, STEPS, _ONE)
        state = traversal.descend(tree, line, state, stack)
        status = _downward(tree, state)
        if status != _TRAVERSING:
            break
    return _record(state, _NONE, _NONE), status


def look_at_leaf(wanted, place, tree, query, kernel):
    """Find the triangles of a leaf."""
    tick(query, wanted, kernel, LEAVES, _ONE)
    state = _search(place)
    triangles = leaf_of(tree, state.node)
    status = _LEAVING if triangles.triangle_count == _NONE else _INTERSECTING
    return _record(state, triangles.block, triangles.triangle_count), status


@device
def _intersect(hits, ray, wanted, found, place, query, kernel):
    line = block_ray(ray_of(ray, query))
    search = resumed(hits, ray, wanted, found, query, None)
    state = _search(place)
    block, left = place.block, np.uint64(place.left)
    status = _INTERSECTING
    for _ in range(query.tests):
        tick(query, wanted, kernel, TESTS, min(left, _LANES))
        search = intersect_block(block, line, search, state.t_in, state.t_out)
        block += BLOCK
        left -= min(left, _LANES)
        if is_full(search):
            status = end_of(search.hit_count, query)
            break
        if left == _NONE:
            status = _LEAVING
            break
    return (np.uint32(search.hit_count), search.t_far), _record(state, block, left), status


def intersect(ray, wanted, found, place, query, kernel):
    """Test a block of triangles."""
    if query.keep:
        return _intersect(query.hits, ray, wanted, found, place, query, kernel)
    return _intersect(None, ray, wanted, found, place, query, kernel)


def continue_search(wanted, found, place, tree, query, kernel):
    """Go on after a leaf, unless nothing more is wanted."""
    tick(query, wanted, kernel, STEPS, _NONE)
    state = _search(place)
    count = np.uint64(found.count)
    status = end_of(count, query)
    is_over = count == wanted.capacity and found.t_far < state.t_out
    if not (is_over or state.t_out >= state.t_end):
        if traversals.restarts(tree, state):
            note(query, wanted, RESTARTS, _ONE)
        state = traversals.continue_search(tree, state, _stack_of(wanted, query))
        if state.is_backtracking:
            note(query, wanted, BACKTRACKS, _ONE)
            status = _CLIMBING
        else:
            status = _downward(tree, state)
    return _record(state, _NONE, _NONE), status


def backtrack(ray, wanted, place, tree, query, kernel):
    """Go to the parent."""
    line = split_ray(ray_of(ray, query))
    state = _search(place)
    status = _CLIMBING
    for _ in range(query.steps):
        tick(query, wanted, kernel, BACKTRACK_STEPS, _ONE)
        state = traversals.backtrack.backtrack(tree, line, state)
        if not state.is_backtracking:
            status = _downward(tree, state)
            break
    return _record(state, _NONE, _NONE), status


_KERNELS = with_shade(
    StepKernel("initialize", RayState.STARTING, device(initialize), ("found", "place")),
    StepKernel("down", RayState.TRAVERSING, device(descend), ("place",), "steps"),
    StepKernel("leaf", RayState.AT_LEAF, device(look_at_leaf), ("place",)),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
    StepKernel("continue", RayState.LEAVING, device(continue_search), ("place",)),
    StepKernel("up", RayState.CLIMBING, device(backtrack), ("place",), "steps"),
)


def steps(tree: KdTreeStructure) -> Steps:
    """The steps of a kd-tree's traversal: its own of the four."""
    stack_bytes = _STACKS.get(int(tree.arrays.traversal), 0)
    return Steps(_KERNELS, PLACE, tree.arrays, stack_bytes)
