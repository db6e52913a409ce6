"""Cutting a triangle at a plane: boxes around the parts on both sides."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import f32x8, lane, load, minimum, store
from raystream.structures.bvh.records import FIRST_AT, no_box

__all__ = ["SIDE_AT", "cut_record"]

#: Where a record keeps its count, and, while a range is split, its side.
SIDE_AT = 28


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
    left, right : uint64
        Where to write.
    """
    triangle = corners + np.uint64(load(np.int32, record + np.uint64(FIRST_AT))) * np.uint64(36)
    whole = load(f32x8, record)
    store(left, no_box())
    store(right, no_box())
    for k in range(np.uint64(3)):
        a = triangle + k * np.uint64(12)
        b = triangle + (np.uint64(0) if k == np.uint64(2) else k + np.uint64(1)) * np.uint64(12)
        at_a, at_b = (
            load(np.float32, a + axis * np.uint64(4)),
            load(np.float32, b + axis * np.uint64(4)),
        )
        if at_a <= position:
            _grow(left, a, a, 0.0)
        if at_a >= position:
            _grow(right, a, a, 0.0)
        if (at_a < position and at_b > position) or (at_a > position and at_b < position):
            share = (np.float64(position) - at_a) / (np.float64(at_b) - at_a)
            _grow(left, a, b, share)
            _grow(right, a, b, share)
    _finish(left, whole, pad)
    _finish(right, whole, pad)
    # Rounding must not let a part reach beyond the plane, but for the pad.
    high = left + np.uint64(16) + axis * np.uint64(4)
    store(high, min(load(np.float32, high), np.float32(position + pad)))
    low = right + axis * np.uint64(4)
    store(low, min(load(np.float32, low), np.float32(pad - position)))


@device
def _grow(box, a, b, share):
    """Include the point between two vertices."""
    for axis in range(np.uint64(3)):
        x = np.float64(load(np.float32, a + axis * np.uint64(4)))
        y = np.float64(load(np.float32, b + axis * np.uint64(4)))
        point = np.float32(x + (y - x) * share)
        low, high = box + axis * np.uint64(4), box + axis * np.uint64(4) + np.uint64(16)
        store(low, max(load(np.float32, low), -point))
        store(high, max(load(np.float32, high), point))


@device
def _finish(box, whole, pad):
    """Pad a box, keep it in the one that is cut, and give it that one's id and count."""
    padded = minimum(load(f32x8, box) + pad, whole)
    store(box, padded)
    store(box + np.uint64(FIRST_AT), lane(whole, 3))
    store(box + np.uint64(SIDE_AT), np.float32(1.0))
