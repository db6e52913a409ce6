"""Triangles in the GPU's layouts: 48 bytes each, read in three loads.

Corner 0 and prim_id; corner 1 and whether the triangle is the last of its leaf; corner 2 and
padding. A warp's threads test triangles of different leaves: with blocks of four, as on the CPU,
they would test the padding of blocks, too.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import f32x4, float_as_bits, lane, load, load_constant, store
from raystream.kernels.leaf_block import BLOCK, BLOCK_SIZE, PRIM_IDS
from raystream.kernels.search import offer
from raystream.kernels.tally import TESTS, add_to
from raystream.kernels.triangle import intersect_corners
from raystream.structures.bvh.node_layout import leaf_address, leaf_end

#: Size of a triangle in bytes and in floats, and of a load.
TRIANGLE = np.uint64(48)
TRIANGLE_FLOATS = int(TRIANGLE) // 4
_ROW = np.uint64(16)  # a corner and one more number
_TWO_ROWS = np.uint64(32)

_LAST = np.uint64(28)


@device
def hittable_count(leaves, child):
    """Number of a leaf's triangles that can be hit: the others have NaN corners."""
    count = np.uint64(0)
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        for k in range(np.uint64(BLOCK_SIZE)):
            at = block + (k << SHIFT_32)
            x = load(np.float32, at)
            if load(np.int32, at + PRIM_IDS) >= np.int32(0) and x == x:
                count += ONE_U64
        block += BLOCK
    return count


@device
def copy_leaf(leaves, child, to):
    """Copy the triangles of a leaf that can be hit.

    Parameters
    ----------
    leaves : uint64
        Address of the CPU's leaf blocks.
    child : int32
        A leaf, as in `BvhArrays`.
    to : uint64
        Address to write to.

    Returns
    -------
    uint64
        Address after the last one.
    """
    first = to
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        for k in range(np.uint64(BLOCK_SIZE)):
            at = block + (k << SHIFT_32)
            prim_id = load(np.int32, at + PRIM_IDS)
            x = load(np.float32, at)
            if prim_id >= np.int32(0) and x == x:
                for corner in range(np.uint64(3)):
                    for axis in range(np.uint64(3)):
                        number = load(np.float32, at + (corner * np.uint64(3) + axis) * _ROW)
                        store(to + corner * _ROW + (axis << SHIFT_32), number)
                store(to + np.uint64(12), prim_id)
                store(to + _LAST, np.int32(0))
                store(to + np.uint64(44), np.int32(0))
                to += TRIANGLE
        block += BLOCK
    if to != first:
        store(to - TRIANGLE + _LAST, np.int32(1))
    return to


@device
def test_triangle(at, ray, search):
    """Test a triangle, and offer its hit to a search.

    Parameters
    ----------
    at : uint64
        Address.
    ray : Ray
    search : Search

    Returns
    -------
    search : Search
    is_last : bool
        Whether the triangle is the last one of its leaf.
    """
    add_to(search.counters, TESTS, ONE_U64)
    a = load_constant(f32x4, at)
    b = load_constant(f32x4, at + _ROW)
    c = load_constant(f32x4, at + _TWO_ROWS)
    is_last = lane(float_as_bits(b), 3) != np.int32(0)
    hit, t, u, v = intersect_corners(ray, _corner(a), _corner(b), _corner(c), search.surfaces)
    # Written so that a NaN would fail.
    if hit and t >= search.t_min and t <= search.t_far:
        search = offer(search, t, u, v, lane(float_as_bits(a), 3))
    return search, is_last


@device
def _corner(numbers):
    return lane(numbers, 0), lane(numbers, 1), lane(numbers, 2)
