"""The traversals of single rays in float64: of the wide tree, and of all triangles.

They go from block to block; what happens there is up to the query, a function of the block.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.float64.block import BLOCK, leaf_end
from raystream.float64.ray import widened_far, widened_near
from raystream.jit.cpu import device
from raystream.jit.simd import (
    f32x8,
    f64x8,
    float_as_bits,
    fma,
    i32x8,
    lane_numbers,
    load,
    maximum,
    minimum,
    narrow,
    widen,
)
from raystream.structures.bvh.node_layout import BOX_FLIP, leaf_address
from raystream.structures.bvh.walk import STACK_BYTES, tree_walk

__all__ = ["STACK_BYTES", "Float64Tree", "all_blocks", "tree_blocks"]

_ZERO = np.float64(0.0)
_ZERO32 = np.float32(0.0)
_KEY_BITS = np.int32(~7)


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
def _enter(node, line, search, t_min, t_far):
    """Test the boxes of a node's children; see `structures.bvh.steps.enter`."""
    ray, _ = line
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
    def interval(line, search):
        ray, _ = line
        far = widened_far(far_of(ray, search))
        # Adding zero turns -0 into 0.
        return widened_near(ray.line.t_min), far, np.float32(far) + _ZERO32

    @device
    def visit_leaf(tree, child, line, search, stack):
        ray, lanes = line
        block = leaf_address(tree.leaves, child)
        end = leaf_end(block, child)
        while block != end:
            search, is_over = visit(block, ray, search, lanes)
            if is_over:
                return search, True
            block += BLOCK
        return search, False

    walk_tree = tree_walk(interval, _enter, visit_leaf)

    @device
    def walk(tree, ray, search, stack, lanes, wants_any):
        return walk_tree(tree, (ray, lanes), search, stack, wants_any)

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
