"""Records: what the builder moves about, 32 bytes for each triangle.

A record is eight float32: -low x, -low y, -low z, the prim_id's bits; high x, high y, high z,
1. With the low corner negated, one `maximum` of two records gives the box around both. Boxes
are kept in the same form; their lane 3 means nothing, and lane 7 may count records.
"""

from __future__ import annotations

import numpy as np

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

__all__ = [
    "COUNT_AT",
    "FIRST_AT",
    "RECORD_BYTES",
    "RECORD_FLOATS",
    "half_area",
    "high_half",
    "low_half",
    "make_records",
    "middle_bounds",
    "no_box",
    "nothing",
    "with_record",
    "write_record",
]

RECORD_BYTES = 32
RECORD_FLOATS = 8

#: Where a record has its prim_id, and a tree node its first record and its record count.
FIRST_AT = 12
COUNT_AT = 28

_INF = np.float32(np.inf)

swap_halves = permutation(4, 5, 6, 7, 0, 1, 2, 3)
low_half = permutation(0, 1, 2, 3)
high_half = permutation(4, 5, 6, 7)


@device
def no_box():
    """The box around nothing."""
    return f32x8(-_INF)


@device
def nothing():
    """The box around nothing, with a count of 0."""
    return select(_not_last(), f32x8(-_INF), f32x8(np.float32(0.0)))


@device
def with_record(box, record):
    """The box around a box and a record, or another box; counts are added."""
    return select(_not_last(), maximum(box, record), box + record)


@device
def _not_last():
    return lanes_from_bits(mask8, 127)


@device
def middle_bounds(record):
    """The box around one point: twice the middle of a record's box."""
    return record - swap_halves(record)


@device
def half_area(box):
    """Half the surface of a box."""
    size = box + swap_halves(box)
    x, y, z = lane(size, 0), lane(size, 1), lane(size, 2)
    return x * y + y * z + z * x


@device
def write_record(corners, prim_id, to):
    """Write the record of a triangle, whose corners are among those at an address."""
    three, one = lanes_from_bits(mask4, 7), f32x4(np.float32(1.0))
    at = corners + np.uint64(prim_id) * np.uint64(36)
    # Each vertex with the number before or after it as a fourth lane: nothing beyond
    # the triangle is read.
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
def make_records(begin, end, corners, prim_ids, records, bounds):
    """Fill rows begin to end of `records`, and two boxes: around them, around their middles.

    Parameters
    ----------
    begin, end : int
    corners : ndarray of shape (F, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
        Rows of `corners`.
    records : ndarray of shape (A, 8), float32
    bounds : ndarray of shape (2, 8), float32
    """
    box, middles = no_box(), no_box()
    corner_address, record_address = address(corners), address(records)
    for i in range(np.uint64(begin), np.uint64(end)):
        to = record_address + i * np.uint64(RECORD_BYTES)
        write_record(corner_address, np.int32(prim_ids[i]), to)
        record = load(f32x8, to)
        box = maximum(box, record)
        middles = maximum(middles, middle_bounds(record))
    store(address(bounds), box)
    store(address(bounds) + np.uint64(RECORD_BYTES), middles)


_last_three = permutation(1, 2, 3, 3)
