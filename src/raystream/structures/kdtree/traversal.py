"""One ray through a kd-tree from start to end: the steps of `steps`, fused."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import scratch
from raystream.kernels.tally import (
    BACKTRACK_STEPS,
    BACKTRACKS,
    LEAVES,
    RESTARTS,
    STEPS,
    TESTS,
    add_to,
)
from raystream.structures.bvh.block import lane_frame
from raystream.structures.bvh.wide import BLOCK
from raystream.structures.kdtree.state import split_ray
from raystream.structures.kdtree.steps import (
    down,
    initialize,
    intersect_block,
    is_at_leaf,
    leaf,
    leave,
    restarts,
    up,
)

__all__ = ["traverse"]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_LANES = np.uint64(4)


@device
def traverse(tree, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen, tally):
    """Search the leaves along a ray; see `kernels.queries.ray_queries` for the arguments."""
    count, t_far = _NONE, t_max
    is_active, state = initialize(tree, ray, t_min, t_max)
    if not is_active:
        return count
    line, frame, lanes = split_ray(ray), lane_frame(ray), scratch(64)
    while True:
        while not is_at_leaf(tree, state):
            state = down(tree, line, state, stack)
            add_to(tally, STEPS, _ONE)
        triangles = leaf(tree, state)
        add_to(tally, LEAVES, _ONE)
        block, left = triangles.block, triangles.triangle_count
        while block != triangles.end:
            count, t_far = intersect_block(
                block, frame, state, t_far, surfaces, keep, count, capacity, first, out, lanes
            )
            add_to(tally, TESTS, min(left, _LANES))
            block, left = block + BLOCK, left - _LANES
            if count == capacity and not keep:
                return count
        # Hits in leaves to come are not before this one's end.
        if count == capacity and t_far < state.t_out:
            return count
        if state.t_out >= state.t_end:
            return count
        if restarts(tree, state):
            add_to(tally, RESTARTS, _ONE)
        state = leave(tree, state, stack)
        if state.is_climbing:
            add_to(tally, BACKTRACKS, _ONE)
        while state.is_climbing:
            state = up(tree, line, state)
            add_to(tally, BACKTRACK_STEPS, _ONE)
