"""The traversals of single rays in float64: of the wide tree, and of all triangles.

They go from block to block; what happens there is up to the query, a function of the block.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.float64.block import BLOCK, leaf_end
from raystream.float64.ray import widened_far, widened_near
from raystream.jit.constants import ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x8,
    f64x8,
    float_as_bits,
    fma,
    i32x8,
    lane_numbers,
    load,
    mask_bits,
    maximum,
    minimum,
    narrow,
    widen,
)
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import (
    BOX_FLIP,
    CHILDREN,
    LANE,
    NODE,
    leaf_address,
    prefetch_child,
)
from raystream.structures.bvh.steps import begin, is_leaf, next_entry, push

_ZERO = np.float64(0.0)
_ZERO32 = np.float32(0.0)
_KEY_BITS = np.int32(~7)

#: Bytes of half the stack, for the deepest tree.
_HALF = np.uint64(-(-4 * STACK_SIZE // 64) * 64)

#: Bytes of the stack.
STACK_BYTES = 2 * int(_HALF)


class Float64Tree(NamedTuple):
    """The arrays of a structure, as addresses; the caller keeps the arrays alive.

    Attributes
    ----------
    nodes : uint64
        The first node of a wide tree, see `structures.bvh.layout`; 0 without one. A leaf's link
        has twice the number of its first block.
    leaves : uint64
        The first block.
    block_count : uint64
    """

    nodes: np.uint64
    leaves: np.uint64
    block_count: np.uint64


@device
def _enter(node, ray, t_min, t_far):
    """Test the boxes of a node's children; see `structures.bvh.steps.enter`."""
    at_x = node + ray.planes[0]
    at_y = node + ray.planes[1]
    at_z = node + ray.planes[2]
    inv, near, far = ray.inv, ray.near, ray.far
    t_in = maximum(
        maximum(
            fma(widen(load(f32x8, at_x)), inv[0], near[0]),
            fma(widen(load(f32x8, at_y)), inv[1], near[1]),
        ),
        fma(widen(load(f32x8, at_z)), inv[2], near[2]),
    )
    t_out = minimum(
        minimum(
            fma(widen(load(f32x8, at_x ^ BOX_FLIP)), inv[0], far[0]),
            fma(widen(load(f32x8, at_y ^ BOX_FLIP)), inv[1], far[1]),
        ),
        fma(widen(load(f32x8, at_z ^ BOX_FLIP)), inv[2], far[2]),
    )
    entered = maximum(t_in, f64x8(t_min)) <= minimum(t_out, f64x8(t_far))
    # Rounding to float32 keeps the order, so that a key is at most that of a farther limit.
    keys = float_as_bits(narrow(maximum(t_in, f64x8(_ZERO))))
    return (keys & _KEY_BITS) | lane_numbers(i32x8), entered


@device
def _limit(t_far):
    """The limit of keys. Adding zero turns -0 into 0, whose bits are in the numbers' order."""
    return np.float32(t_far) + _ZERO32


def tree_blocks(visit: Callable[..., Any], far_of: Callable[..., Any]) -> Callable[..., Any]:
    """Make the traversal of a wide tree.

    Parameters
    ----------
    visit : device function
        ``visit(block, ray, search, lanes) -> (search, is_over)`` offers the triangles of a block;
        `lanes` is the address of 64 bytes.
    far_of : device function
        ``far_of(ray, search)`` is the distance beyond which no hit is wanted.

    Returns
    -------
    device function
        ``walk(tree, ray, search, stack, lanes, wants_any) -> search``
    """

    @device
    def walk(tree, ray, search, stack, lanes, wants_any):
        t_min = widened_near(ray.line.t_min)
        t_far = widened_far(far_of(ray, search))
        if not t_min <= t_far:
            return search
        top = begin(tree, _ZERO32, _ZERO32, stack, _HALF)
        found, child, top = next_entry(stack, _HALF, top, _limit(t_far))
        while found:
            if is_leaf(child):
                block = leaf_address(tree.leaves, child)
                end = leaf_end(block, child)
                while block != end:
                    search, is_over = visit(block, ray, search, lanes)
                    if is_over:
                        return search
                    block += BLOCK
                t_far = widened_far(far_of(ray, search))
            else:
                node = tree.nodes + np.uint64(child) * NODE
                keys, entered = _enter(node, ray, t_min, t_far)
                bits = mask_bits(entered)
                if bits != ZERO_U64:
                    if bits & (bits - ONE_U64) == ZERO_U64:
                        at = node + CHILDREN + (count_trailing_zeros(bits) << SHIFT_32)
                        child = load(np.int32, at)
                        continue
                    top = push(node, keys, entered, wants_any, stack, _HALF, top)
                    top -= LANE  # the last one is within the interval
                    child = load(np.int32, stack + _HALF + top)
                    if top != ZERO_U64:
                        below = load(np.int32, stack + _HALF + top - LANE)
                        prefetch_child(below, tree.nodes, tree.leaves)
                    continue
            found, child, top = next_entry(stack, _HALF, top, _limit(t_far))
        return search

    return walk


def all_blocks(visit: Callable[..., Any], far_of: Callable[..., Any]) -> Callable[..., Any]:
    """Make the traversal of all blocks; see `tree_blocks`."""

    @device
    def walk(tree, ray, search, stack, lanes, wants_any):
        if not ray.line.t_min <= far_of(ray, search):
            return search
        block = tree.leaves
        for _ in range(tree.block_count):
            search, is_over = visit(block, ray, search, lanes)
            if is_over:
                return search
            block += BLOCK
        return search

    return walk
