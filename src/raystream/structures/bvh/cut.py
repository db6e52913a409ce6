"""Cutting a record at a plane: boxes around what is on both sides.

What is cut is not the triangle but its plane inside the record's box, both grown by the bound of
`structures.clip`: hits that rounding accepts lie there, and not always between the triangle's
edges. (Boxes around the parts of the triangle itself lost one in 400 of the hits of rays that
nearly lie in a triangle's plane and pass its edge.)
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import f32x8, lane, load, scratch, store
from raystream.structures.bvh.records import FIRST_AT, no_box
from raystream.structures.clip import BOUND, tighten

__all__ = ["PAD", "SIDE_AT", "cut_record"]

#: Where a record keeps its count, and, while a range is split, its side.
SIDE_AT = 28

#: Boxes of parts reach so far beyond the plane that cut them, in units of the scene's largest
#: coordinate, so that no rounding lets a hit fall between them.
PAD = 2.0**-20

_BOUND_PADS = np.float64(BOUND / PAD)
_AXES = np.uint64(3)
_LANE = np.uint64(4)
_HIGH = np.uint64(16)
_BOX_HIGH = np.uint64(12)


@device_call
def cut_record(record, corners, axis, position, pad, left, right):
    """Write the boxes of the parts of a record on both sides of a plane, as records.

    Parameters
    ----------
    record : uint64
        Address of the record.
    corners : uint64
        Address of all triangles' corners.
    axis : uint64
    position, pad : float32
        The plane, and `PAD` in the scene's unit.
    left, right : uint64
        Where to write; `no_box` where nothing is.
    """
    triangle = corners + np.uint64(load(np.int32, record + np.uint64(FIRST_AT))) * np.uint64(36)
    whole = load(f32x8, record)
    store(left, whole)
    high = left + _HIGH + axis * _LANE
    store(high, min(load(np.float32, high), np.float32(position + pad)))
    store(right, whole)
    low = right + axis * _LANE
    store(low, min(load(np.float32, low), np.float32(pad - position)))
    _finish(left, triangle, whole, pad)
    _finish(right, triangle, whole, pad)


@device
def _finish(part, triangle, whole, pad):
    """Shrink a part's box to the triangle's plane, and give it the record's id and count."""
    bound = np.float64(pad) * _BOUND_PADS
    grown = scratch(24)
    for axis in range(_AXES):
        at = axis * _LANE
        store(grown + at, np.float32(-load(np.float32, part + at) - bound))
        store(grown + _BOX_HIGH + at, np.float32(load(np.float32, part + _HIGH + at) + bound))
    if tighten(triangle, bound, grown):
        for axis in range(_AXES):
            at = axis * _LANE
            low = min(load(np.float32, part + at), -load(np.float32, grown + at))
            high = min(
                load(np.float32, part + _HIGH + at), load(np.float32, grown + _BOX_HIGH + at)
            )
            if -low <= high:
                store(part + at, low)
                store(part + _HIGH + at, high)
    else:
        store(part, no_box())
    store(part + np.uint64(FIRST_AT), lane(whole, 3))
    store(part + np.uint64(SIDE_AT), np.float32(1.0))
