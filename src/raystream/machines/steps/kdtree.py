"""The kd-tree as Foley's kernels: Initialize, Down, Leaf, Intersect, Continue, Up.

Foley 2005, section 3.3. Intersect takes a block of up to four triangles at a time.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
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
from raystream.machines.records import (
    AT_LEAF,
    BACKTRACKING,
    CONTINUING,
    INTERSECTING,
    TRAVERSING,
    RayState,
    add_count,
    count_step,
    end_state,
    found_by,
    prepared_ray,
    stack_of,
)
from raystream.machines.steps.base import StepKernel, Steps, resume_search, with_shade
from raystream.structures.kdtree import traversal, traversals
from raystream.structures.kdtree.nodes import is_leaf, leaf_of
from raystream.structures.kdtree.state import (
    SHORT_STACK,
    SHORT_STACK_BYTES,
    STACK,
    STACK_BYTES,
    KdState,
)
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream.structures.plane_distances import split_ray

#: The traversal state of a ray: `KdState`, the next block of its leaf, and the number of
#: triangles in it and those after it.
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

#: Bytes of a ray's stack, by traversal.
_STACKS = {int(STACK): STACK_BYTES, int(SHORT_STACK): SHORT_STACK_BYTES}

_LANES = np.uint64(4)


@device
def _load(place):
    """A record of `PLACE` as a `KdState`."""
    node, top = np.uint64(place.node), np.uint64(place.top)
    return KdState(node, place.t_in, place.t_out, place.t_end, top, False)


@device
def _record(state, block, left):
    """A `KdState` and the blocks that are left as a record of `PLACE`."""
    node, top = np.uint32(state.node), np.uint32(state.top)
    return (node, state.t_in, state.t_out, state.t_end, top, block, np.uint32(left))


@device
def _downward(tree, state):
    """What a ray does next at a node."""
    return AT_LEAF if is_leaf(tree, state.node) else TRAVERSING


def initialize(ray, wanted, tree, query, kernel):
    """Begin at the root."""
    count_step(query, wanted, kernel, STEPS, ZERO_U64)
    is_active, state = traversal.initialize(tree, prepared_ray(ray, query), ray.t_min, ray.t_max)
    status = end_state(ZERO_U64, query)
    if is_active:
        status = _downward(tree, state)
    return (np.uint32(0), ray.t_max), _record(state, ZERO_U64, ZERO_U64), status


def descend(ray, wanted, place, tree, query, kernel):
    """Descend to a child."""
    line, stack = split_ray(prepared_ray(ray, query)), stack_of(wanted, query)
    state = _load(place)
    status = TRAVERSING
    for _ in range(query.steps):
        count_step(query, wanted, kernel, STEPS, ONE_U64)
        state = traversal.descend(tree, line, state, stack)
        status = _downward(tree, state)
        if status != TRAVERSING:
            break
    return _record(state, ZERO_U64, ZERO_U64), status


def look_at_leaf(wanted, place, tree, query, kernel):
    """Find the triangles of a leaf."""
    count_step(query, wanted, kernel, LEAVES, ONE_U64)
    state = _load(place)
    triangles = leaf_of(tree, state.node)
    status = CONTINUING if triangles.triangle_count == ZERO_U64 else INTERSECTING
    return _record(state, triangles.block, triangles.triangle_count), status


def intersect(ray, wanted, found, place, query, kernel):
    """Test a block of triangles."""
    line = block_ray(prepared_ray(ray, query))
    search = resume_search(query.hits, ray, wanted, found, query)
    state = _load(place)
    block, left = place.block, np.uint64(place.left)
    status = INTERSECTING
    for _ in range(query.tests):
        count_step(query, wanted, kernel, TESTS, min(left, _LANES))
        search = intersect_block(block, line, search, state.t_in, state.t_out)
        block += BLOCK
        left -= min(left, _LANES)
        if is_full(search):
            status = end_state(search.hit_count, query)
            break
        if left == ZERO_U64:
            status = CONTINUING
            break
    return found_by(search), _record(state, block, left), status


def continue_search(wanted, found, place, tree, query, kernel):
    """Continue after a leaf, unless the search is over."""
    count_step(query, wanted, kernel, STEPS, ZERO_U64)
    state = _load(place)
    count = np.uint64(found.count)
    status = end_state(count, query)
    is_over = count == wanted.capacity and found.t_far < state.t_out
    if not (is_over or state.t_out >= state.t_end):
        if traversals.restarts(tree, state):
            add_count(query, wanted, RESTARTS, ONE_U64)
        state = traversals.continue_search(tree, state, stack_of(wanted, query))
        if state.is_backtracking:
            add_count(query, wanted, BACKTRACKS, ONE_U64)
            status = BACKTRACKING
        else:
            status = _downward(tree, state)
    return _record(state, ZERO_U64, ZERO_U64), status


def backtrack(ray, wanted, place, tree, query, kernel):
    """Climb to the parent."""
    line = split_ray(prepared_ray(ray, query))
    state = _load(place)
    status = BACKTRACKING
    for _ in range(query.steps):
        count_step(query, wanted, kernel, BACKTRACK_STEPS, ONE_U64)
        state = traversals.backtrack.backtrack(tree, line, state)
        if not state.is_backtracking:
            status = _downward(tree, state)
            break
    return _record(state, ZERO_U64, ZERO_U64), status


_KERNELS = with_shade(
    StepKernel("initialize", RayState.STARTING, device(initialize), ("found", "place")),
    StepKernel("down", RayState.TRAVERSING, device(descend), ("place",), "steps"),
    StepKernel("leaf", RayState.AT_LEAF, device(look_at_leaf), ("place",)),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
    StepKernel("continue", RayState.CONTINUING, device(continue_search), ("place",)),
    StepKernel("up", RayState.BACKTRACKING, device(backtrack), ("place",), "steps"),
)


def steps(tree: KdTreeStructure) -> Steps:
    """The steps of a kd-tree's own traversal, one of four."""
    stack_bytes = _STACKS.get(int(tree.view.traversal), 0)
    return Steps(_KERNELS, PLACE, tree.view, stack_bytes)
