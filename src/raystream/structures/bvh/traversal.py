"""Traversal of the wide tree by a single ray: the steps of `steps`, fused. For all queries.

The nearest child that the ray enters is visited at once, without the stack where it is the only
one. A search that ends at any hit takes children unsorted. The next entry of the stack, to which
the ray may return at any time, is prefetched.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import count_trailing_zeros, load, mask_bits
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block, triangle_count
from raystream.kernels.search import is_full, wants_any
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import CHILDREN, LANE, NODE, prefetch_child
from raystream.structures.bvh.steps import (
    begin,
    enter,
    is_leaf,
    leaf_blocks,
    next_entry,
    push,
)

_INF = np.float32(np.inf)

#: Bytes of half the stack, for the deepest tree.
HALF = np.uint64(-(-4 * STACK_SIZE // 64) * 64)

#: Bytes of the stack of `traverse`.
STACK_BYTES = 2 * int(HALF)


@device
def prefetch_next(tree, stack, top):
    """Prefetch the child on top of the stack of halves of `HALF` bytes, if there is one."""
    if top != ZERO_U64:
        prefetch_child(load(np.int32, stack + HALF + top - LANE), tree.nodes, tree.leaves)


def tree_traversal(search_leaf):
    """Make the traversal of a wide tree.

    Parameters
    ----------
    search_leaf : device function
        ``search_leaf(tree, child, line, search, stack) -> search`` offers the hits in a leaf to a
        search; `line` is the `BlockRay`. The memory at `stack` + `STACK_BYTES` is its own.

    Returns
    -------
    function
        See `kernels.queries.ray_queries`.
    """

    def traverse(tree, ray, search, stack):
        line = block_ray(ray)
        top = begin(tree, search.t_min, search.t_far, stack, HALF)
        found, child, top = next_entry(stack, HALF, top, search.t_far)
        while found:
            if is_leaf(child):
                add_to(search.counters, LEAVES, ONE_U64)
                prefetch_next(tree, stack, top)
                search = search_leaf(tree, child, line, search, stack)
                if is_full(search):
                    return search
            else:
                add_to(search.counters, STEPS, ONE_U64)
                node = tree.nodes + np.uint64(child) * NODE
                keys, entered = enter(node, line, search.t_min, search.t_far)
                lanes = mask_bits(entered)
                if lanes != ZERO_U64:
                    if lanes & (lanes - ONE_U64) == ZERO_U64:
                        at = node + CHILDREN + (count_trailing_zeros(lanes) << SHIFT_32)
                        child = load(np.int32, at)
                        continue
                    top = push(node, keys, entered, wants_any(search), stack, HALF, top)
                    top -= LANE  # the last one is within the interval
                    child = load(np.int32, stack + HALF + top)
                    prefetch_next(tree, stack, top)
                    continue
            found, child, top = next_entry(stack, HALF, top, search.t_far)
        return search

    return traverse


@device
def _search_blocks(tree, child, line, search, stack):
    block, end = leaf_blocks(tree, child)
    while block != end:
        add_to(search.counters, TESTS, triangle_count(block))
        search = intersect_block(block, line, search, search.t_min, _INF)
        if is_full(search):
            break
        block += BLOCK
    return search


#: Traverse the tree of triangles with a ray.
traverse = device(tree_traversal(_search_blocks))
