"""One ray through the wide tree: the steps of `steps`, fused. It answers every query."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import address, scratch
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.structures.bvh.block import lane_frame
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.steps import (
    begin,
    intersect_block,
    is_leaf,
    is_over,
    leaf_blocks,
    next_entry,
    triangle_count,
    visit,
)
from raystream.structures.bvh.wide import BLOCK

__all__ = ["STACK_BYTES", "traverse"]

_ONE = np.uint64(1)
_NONE = np.uint64(0)

#: Bytes of a half of the stack, for the deepest of trees.
_HALF = np.uint64(-(-4 * STACK_SIZE // 64) * 64)

#: Bytes of the stack that `traverse` is given.
STACK_BYTES = 2 * int(_HALF)


@device
def traverse(tree, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen, tally):
    """Visit the boxes that a ray meets; see `kernels.queries.ray_queries` for the arguments."""
    count, t_far = _NONE, t_max
    frame, lanes = lane_frame(ray), scratch(64)
    table, room = address(seen), np.uint64(len(seen)) - _ONE
    top = begin(tree, t_min, t_max, stack, _HALF)
    while True:
        found, child, top = next_entry(stack, _HALF, top, t_far)
        if not found:
            return count
        if is_leaf(child):
            add_to(tally, LEAVES, _ONE)
            block, end = leaf_blocks(tree, child)
            while block != end:
                add_to(tally, TESTS, triangle_count(block))
                count, t_far = intersect_block(
                    block,
                    frame,
                    t_min,
                    t_far,
                    surfaces,
                    keep,
                    count,
                    capacity,
                    first,
                    out,
                    table,
                    room,
                    lanes,
                )
                if is_over(count, capacity, keep):
                    return count
                block += BLOCK
        else:
            add_to(tally, STEPS, _ONE)
            top = visit(tree, child, frame, t_min, t_far, stack, _HALF, top)
