"""Primitive references, which the builder sorts: 32 bytes per triangle, a box and its prim_id.

A reference is eight float32: -low x, -low y, -low z, the prim_id's bits; high x, high y, high z,
1. With the low corner negated, the `maximum` of two references is the box around both. Boxes have
the same form; their lane 3 is unused, and lane 7 may count references.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    f32x4,
    f32x8,
    lane,
    lanes_from_bits,
    load,
    mask4,
    mask8,
    maximum,
    permutation,
    select,
    store,
)

REF_BYTES = 32
REF_FLOATS = 8

#: Byte offsets of a reference's prim_id, and of a tree node's first reference and their number.
FIRST_AT = 12
COUNT_AT = 28


swap_halves = permutation(4, 5, 6, 7, 0, 1, 2, 3)
low_half = permutation(0, 1, 2, 3)
high_half = permutation(4, 5, 6, 7)


@device
def empty_box():
    """The empty box."""
    return f32x8(-INF_F32)


@device
def empty_bin():
    """The empty box, with a count of 0."""
    return select(_not_last(), f32x8(-INF_F32), f32x8(np.float32(0.0)))


@device
def union(box, ref):
    """The union of a box with a reference or another box; counts are added."""
    return select(_not_last(), maximum(box, ref), box + ref)


@device
def _not_last():
    return lanes_from_bits(mask8, 127)


@device
def centroid_bounds(ref):
    """The bounds of a point: twice the centroid of a reference's box."""
    return ref - swap_halves(ref)


@device
def half_area(box):
    """Half the surface area of a box."""
    size = box + swap_halves(box)
    x, y, z = lane(size, 0), lane(size, 1), lane(size, 2)
    return x * y + y * z + z * x


@device
def write_ref(corners, prim_id, to):
    """Write the reference of a triangle; `corners` is the address of all triangles' corners."""
    three, one = lanes_from_bits(mask4, 7), f32x4(np.float32(1.0))
    at = corners + np.uint64(prim_id) * np.uint64(36)
    # The fourth lane of each vertex is a neighbour in the triangle: nothing past it is read.
    a = load(f32x4, at)
    b = load(f32x4, at + np.uint64(12))
    c = _last_three(load(f32x4, at + np.uint64(20)))
    negated = f32x4(np.float32(0.0))
    low = maximum(negated - a, maximum(negated - b, negated - c))
    high = maximum(a, maximum(b, c))
    store(to, low)
    store(to + np.uint64(16), select(three, high, one))
    store(to + np.uint64(FIRST_AT), prim_id)


@kernel
def make_refs(begin, end, corners, prim_ids, refs, bounds):
    """Fill rows begin to end of `refs`, and two boxes: bounds of these and of their centroids.

    Parameters
    ----------
    begin, end : int
    corners : ndarray of shape (F, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
        Rows of `corners`.
    refs : ndarray of shape (A, 8), float32
    bounds : ndarray of shape (2, 8), float32
    """
    box, centroids = empty_box(), empty_box()
    corner_address, ref_address = address(corners), address(refs)
    for i in range(np.uint64(begin), np.uint64(end)):
        to = ref_address + i * np.uint64(REF_BYTES)
        write_ref(corner_address, np.int32(prim_ids[i]), to)
        ref = load(f32x8, to)
        box = maximum(box, ref)
        centroids = maximum(centroids, centroid_bounds(ref))
    store(address(bounds), box)
    store(address(bounds) + np.uint64(REF_BYTES), centroids)


_last_three = permutation(1, 2, 3, 3)
