"""One ray through a kd-tree from start to end: the steps of `steps`, fused."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import scratch
from raystream.structures.bvh.traversal import lane_frame
from raystream.structures.bvh.wide import BLOCK
from raystream.structures.kdtree.state import split_ray
from raystream.structures.kdtree.steps import (
    down,
    initialize,
    intersect_block,
    is_at_leaf,
    leaf,
    leave,
    up,
)

__all__ = ["traverse"]

_NONE = np.uint64(0)


@device
def traverse(tree, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen):
    """Search the leaves along a ray; see `kernels.queries.ray_queries` for the arguments."""
    count, t_far = _NONE, t_max
    is_active, state = initialize(tree, ray, t_min, t_max)
    if not is_active:
        return count
    line, frame, lanes = split_ray(ray), lane_frame(ray), scratch(64)
    while True:
        while not is_at_leaf(tree, state):
            state = down(tree, line, state, stack)
        triangles = leaf(tree, state)
        block = triangles.block
        while block != triangles.end:
            count, t_far = intersect_block(
                block, frame, state, t_far, surfaces, keep, count, capacity, first, out, lanes
            )
            block += BLOCK
            if count == capacity and not keep:
                return count
        # Hits in leaves to come are not before this one's end.
        if count == capacity and t_far < state.t_out:
            return count
        if state.t_out >= state.t_end:
            return count
        state = leave(tree, state, stack)
        while state.is_climbing:
            state = up(tree, line, state)
