"""The traversals of single rays in float64: of the wide tree, and of all triangles.

They go from block to block; what happens to the hits there is up to the query.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.block import BLOCK, PRIM_IDS, block_test, leaf_end, load_edges
from raystream.geometry.float64.ray import widened_far, widened_near
from raystream.jit.constants import ONE_U64, ZERO_F32, ZERO_F64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    f32x8,
    f64x4,
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
from raystream.kernels.leaf_block import triangle_count
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.structures.bvh.node_layout import BOX_FLIP, leaf_address
from raystream.structures.bvh.walks.single import STACK_BYTES, tree_walk

__all__ = ["STACK_BYTES", "Float64Tree", "all_blocks", "box_walk", "tree_blocks"]

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
def box_interval(first, last, ray):
    """Distances at which a ray enters and leaves boxes.

    Parameters
    ----------
    first, last : triple of float32 vectors or numbers
        The planes that it enters and leaves by.
    ray : Float64Ray
    """
    inv, near, far = ray.inv, ray.near, ray.far
    x_in, x_out = fma(widen(first[0]), inv[0], near[0]), fma(widen(last[0]), inv[0], far[0])
    y_in, y_out = fma(widen(first[1]), inv[1], near[1]), fma(widen(last[1]), inv[1], far[1])
    z_in, z_out = fma(widen(first[2]), inv[2], near[2]), fma(widen(last[2]), inv[2], far[2])
    return maximum(maximum(x_in, y_in), z_in), minimum(minimum(x_out, y_out), z_out)


@device
def _enter(node, line, search, t_min, t_far):
    """Test the boxes of a node's children; see `structures.bvh.steps.enter`."""
    ray, _, tally = line
    add_to(tally, STEPS, ONE_U64)
    at_x, at_y, at_z = node + ray.planes[0], node + ray.planes[1], node + ray.planes[2]
    first = load(f32x8, at_x), load(f32x8, at_y), load(f32x8, at_z)
    last = load(f32x8, at_x ^ BOX_FLIP), load(f32x8, at_y ^ BOX_FLIP), load(f32x8, at_z ^ BOX_FLIP)
    t_in, t_out = box_interval(first, last, ray)
    entered = maximum(t_in, f64x8(t_min)) <= minimum(t_out, f64x8(t_far))
    # Rounding to float32 keeps the order, so that a key is at most that of a farther limit.
    keys = float_as_bits(narrow(maximum(t_in, f64x8(ZERO_F64))))
    return (keys & _KEY_BITS) | lane_numbers(i32x8), entered


@device
def _interval(line, search):
    ray, _, _ = line
    far = widened_far(search.t_far)
    # Adding zero turns -0 into 0.
    return widened_near(ray.line.t_min), far, np.float32(far) + ZERO_F32


@device
def _count_tests(tally, block):
    """Count the triangles of a block; without a tally, GPUs need not know how."""
    if tally is not None:
        add_to(tally, TESTS, triangle_count(block + PRIM_IDS))


def blocks_by(
    make_walk: Callable[..., Any], enter: Callable[..., Any]
) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Make a maker of traversals of trees.

    Parameters
    ----------
    make_walk : callable
        As `structures.bvh.walks.single.tree_walk`.
    enter : device function
        See there.

    Returns
    -------
    callable
        ``make_traversal(take)``, for what becomes of the hits, see `block.block_test`, makes a
        device function ``walk(tree, line, search, stack, wants_any) -> search``. `line` has a
        `Float64Ray`, the address of 64 bytes, and the ray's tally or None. See `tree_walk` for
        the others.
    """

    def make_traversal(take: Callable[..., Any]) -> Callable[..., Any]:
        test_block = block_test(take)

        @device
        def visit_leaf(tree, child, line, search, stack):
            ray, spans, tally = line
            add_to(tally, LEAVES, ONE_U64)
            block = leaf_address(tree.leaves, child)
            end = leaf_end(block, child)
            while block != end:
                _count_tests(tally, block)
                edges = load_edges(f64x4, block)
                search, is_over = test_block(search, ray.line, edges, block, spans)
                if is_over:
                    return search, True
                block += BLOCK
            return search, False

        return make_walk(_interval, enter, visit_leaf)

    return make_traversal


def box_walk(visit_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the walk of a tree over boxes with any leaf; see `tree_walk`, and `blocks_by`."""
    return tree_walk(_interval, _enter, visit_leaf)


#: Makes traversals of wide trees.
tree_blocks = blocks_by(tree_walk, _enter)


def all_blocks(take: Callable[..., Any]) -> Callable[..., Any]:
    """Make the traversal of all blocks; see `blocks_by`."""
    test_block = block_test(take)

    @device
    def walk(tree, line, search, stack, wants_any):
        ray, spans, tally = line
        if not ray.line.t_min <= search.t_far:
            return search
        block = tree.leaves
        for _ in range(tree.block_count):
            _count_tests(tally, block)
            edges = load_edges(f64x4, block)
            search, is_over = test_block(search, ray.line, edges, block, spans)
            if is_over:
                return search
            block += BLOCK
        return search

    return walk
