"""Traversal of the wide tree by a single ray: the steps of `steps`, fused. For all queries."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block, triangle_count
from raystream.kernels.search import is_full
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.steps import begin, is_leaf, leaf_blocks, next_entry, visit

__all__ = ["STACK_BYTES", "traverse"]

_ONE = np.uint64(1)
_INF = np.float32(np.inf)

#: Bytes of half the stack, for the deepest tree.
_HALF = np.uint64(-(-4 * STACK_SIZE // 64) * 64)

#: Bytes of the stack of `traverse`.
STACK_BYTES = 2 * int(_HALF)


@device
def traverse(tree, ray, search, stack):
    """Traverse the tree with a ray; see `kernels.queries.ray_queries` for the arguments."""
    line = block_ray(ray)
    top = begin(tree, search.t_min, search.t_far, stack, _HALF)
    while True:
        found, child, top = next_entry(stack, _HALF, top, search.t_far)
        if not found:
            return search
        if is_leaf(child):
            add_to(search.counters, LEAVES, _ONE)
            block, end = leaf_blocks(tree, child)
            while block != end:
                add_to(search.counters, TESTS, triangle_count(block))
                search = intersect_block(block, line, search, search.t_min, _INF)
                if is_full(search):
                    return search
                block += BLOCK
        else:
            add_to(search.counters, STEPS, _ONE)
            top = visit(tree, child, line, search.t_min, search.t_far, stack, _HALF, top)
