"""The walk of one ray or point through the wide tree, for any test of boxes and any leaf.

The nearest child that is entered is visited at once, without the stack where it is the only one. A
search that ends at any hit takes children unsorted. The next entry of the stack, to which the walk
may return at any time, is prefetched.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import count_trailing_zeros, load, mask_bits
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import CHILDREN, LANE, NODE, prefetch_child
from raystream.structures.bvh.steps import begin, is_leaf, next_entry, push

#: Bytes of half the stack, for the deepest tree.
_HALF = np.uint64(-(-4 * STACK_SIZE // 64) * 64)

#: Bytes of the stack.
STACK_BYTES = 2 * int(_HALF)


@device
def _prefetch_next(tree, stack, top):
    """Prefetch the child on top of the stack, if there is one."""
    if top != ZERO_U64:
        prefetch_child(load(np.int32, stack + _HALF + top - LANE), tree.nodes, tree.leaves)


def tree_walk(
    interval: Callable[..., Any], enter: Callable[..., Any], visit_leaf: Callable[..., Any]
) -> Callable[..., Any]:
    """Make the walk of a wide tree.

    Parameters
    ----------
    interval : device function
        ``interval(line, search) -> (near, far, last)``: the closed interval of distances in which
        boxes are wanted, and `far` as float32, in which it must not be -0.
    enter : device function
        ``enter(node, line, search, near, far) -> (keys, entered)``; see `steps.enter`.
    visit_leaf : device function
        ``visit_leaf(tree, child, line, search, stack) -> (search, is_over)`` offers what is in a
        leaf to a search. The memory at `stack` + `STACK_BYTES` is its own.

    Returns
    -------
    device function
        ``walk(tree, line, search, stack, wants_any) -> search``. `tree` has the addresses `nodes`
        and `leaves`; `line` is the ray or point as the functions take it. Children are not sorted
        if `wants_any`: then the interval must not shrink.
    """

    @device
    def walk(tree, line, search, stack, wants_any):
        near, far, last = interval(line, search)
        top = begin(tree, near, far, stack, _HALF)
        found, child, top = next_entry(stack, _HALF, top, last)
        while found:
            if is_leaf(child):
                _prefetch_next(tree, stack, top)
                search, is_over = visit_leaf(tree, child, line, search, stack)
                if is_over:
                    return search
                near, far, last = interval(line, search)
            else:
                node = tree.nodes + np.uint64(child) * NODE
                keys, entered = enter(node, line, search, near, far)
                lanes = mask_bits(entered)
                if lanes != ZERO_U64:
                    if lanes & (lanes - ONE_U64) == ZERO_U64:
                        at = node + CHILDREN + (count_trailing_zeros(lanes) << SHIFT_32)
                        child = load(np.int32, at)
                        continue
                    top = push(node, keys, entered, wants_any, stack, _HALF, top)
                    top -= LANE  # the last one is within the interval
                    child = load(np.int32, stack + _HALF + top)
                    _prefetch_next(tree, stack, top)
                    continue
            found, child, top = next_entry(stack, _HALF, top, last)
        return search

    return walk
