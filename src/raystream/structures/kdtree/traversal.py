"""One ray through a kd-tree from start to end: the steps of `steps`, fused."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block
from raystream.kernels.search import is_full, is_over
from raystream.kernels.tally import (
    BACKTRACK_STEPS,
    BACKTRACKS,
    LEAVES,
    RESTARTS,
    STEPS,
    TESTS,
    add_to,
)
from raystream.structures.kdtree.state import split_ray
from raystream.structures.kdtree.steps import (
    backtrack,
    continue_search,
    descend,
    initialize,
    is_at_leaf,
    leaf,
    restarts,
)

__all__ = ["traverse"]

_ONE = np.uint64(1)
_LANES = np.uint64(4)


@device
def traverse(tree, ray, search, stack):
    """Search the leaves along a ray; see `kernels.queries.ray_queries` for the arguments."""
    is_active, state = initialize(tree, ray, search.t_min, search.t_far)
    if not is_active:
        return search
    line, triangle_ray = split_ray(ray), block_ray(ray)
    while True:
        while not is_at_leaf(tree, state):
            state = descend(tree, line, state, stack)
            add_to(search.counters, STEPS, _ONE)
        triangles = leaf(tree, state)
        add_to(search.counters, LEAVES, _ONE)
        block, left = triangles.block, triangles.triangle_count
        while block != triangles.end:
            search = intersect_block(block, triangle_ray, search, state.t_in, state.t_out)
            add_to(search.counters, TESTS, min(left, _LANES))
            block, left = block + BLOCK, left - _LANES
            if is_full(search):
                return search
        if is_over(search, state.t_out) or state.t_out >= state.t_end:
            return search
        if restarts(tree, state):
            add_to(search.counters, RESTARTS, _ONE)
        state = continue_search(tree, state, stack)
        if state.is_backtracking:
            add_to(search.counters, BACKTRACKS, _ONE)
        while state.is_backtracking:
            state = backtrack(tree, line, state)
            add_to(search.counters, BACKTRACK_STEPS, _ONE)
