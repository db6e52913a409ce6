"""Triangles in the GPU's layout, 48 bytes each, read in three loads; and leaves of them.

The nine numbers of its corners; prim_id; whether it is the last triangle of its leaf; and padding.
A warp's threads test triangles of different leaves: with blocks of four, as on the CPU, they would
test the padding of blocks, too.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.walk import one_tree, ray_traversal
from raystream.jit.constants import NULL, ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import f32x4, float_as_bits, lane, load, load_constant, store
from raystream.kernels.leaf_block import AXIS, BLOCK, BLOCK_SIZE, PRIM_IDS
from raystream.kernels.search import is_full, offer
from raystream.kernels.triangle import intersect_corners
from raystream.structures.bvh.node_layout import leaf_address, leaf_end

#: Size of a triangle in bytes and in floats.
TRIANGLE = np.uint64(48)
TRIANGLE_FLOATS = int(TRIANGLE) // 4

#: Offsets of its second and third load, its prim_id, and the mark of the last one.
_SECOND, _THIRD = np.uint64(16), np.uint64(32)
TRIANGLE_ID, _LAST, _PADDING = np.uint64(36), np.uint64(40), np.uint64(44)

_NUMBERS = np.uint64(9)


@device
def copy_leaf(leaves, child, to):
    """Copy the triangles of a leaf that can be hit: the others have NaN corners.

    Parameters
    ----------
    leaves : uint64
        Address of the CPU's leaf blocks.
    child : int32
        A leaf, as in `BvhArrays`.
    to : uint64
        Address to write to; 0 to count only.

    Returns
    -------
    uint64
        Their number.
    """
    count = ZERO_U64
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        for k in range(np.uint64(BLOCK_SIZE)):
            at = block + (k << SHIFT_32)
            prim_id = load(np.int32, at + PRIM_IDS)
            x = load(np.float32, at)
            if prim_id < np.int32(0) or x != x:
                continue
            if to != NULL:
                own = to + count * TRIANGLE
                for number in range(_NUMBERS):
                    store(own + (number << SHIFT_32), load(np.float32, at + number * AXIS))
                store(own + TRIANGLE_ID, prim_id)
                store(own + _LAST, np.int32(0))
                store(own + _PADDING, np.int32(0))
            count += ONE_U64
        block += BLOCK
    if to != NULL and count != ZERO_U64:
        store(to + (count - ONE_U64) * TRIANGLE + _LAST, np.int32(1))
    return count


@device
def is_last(triangle):
    """Whether the triangle at an address is the last one of its leaf."""
    return load(np.int32, triangle + _LAST) != np.int32(0)


@device
def search_triangles(tree, link, ray, search, _stack):
    """Offer the hits in a leaf to a search; returns it, and whether it is full."""
    at = tree.leaves + np.uint64(~link) * TRIANGLE
    while True:
        first = load_constant(f32x4, at)
        second = load_constant(f32x4, at + _SECOND)
        third = load_constant(f32x4, at + _THIRD)
        a = lane(first, 0), lane(first, 1), lane(first, 2)
        b = lane(first, 3), lane(second, 0), lane(second, 1)
        c = lane(second, 2), lane(second, 3), lane(third, 0)
        hit, t, u, v = intersect_corners(ray, a, b, c, search.goal.surfaces)
        # Written so that a NaN would fail.
        if hit and t >= search.t_min and t <= search.t_far:
            search = offer(search, t, u, v, lane(float_as_bits(third), 1))
            if is_full(search):
                return search, True
        if lane(float_as_bits(third), 2) != np.int32(0):
            return search, False
        at += TRIANGLE


#: Traverse a tree of triangles with a ray.
traverse = ray_traversal(one_tree(search_triangles))
