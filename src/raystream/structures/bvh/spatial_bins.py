"""Find the plane of a spatial split: bins along each axis, and references clipped to them.

What is clipped is not the triangle but its plane inside the reference's box, both grown by the
bound of `structures.clip`: hits that rounding accepts lie there, and not always between the
triangle's edges. (Boxes around the parts of the triangle itself lost one in 400 of the hits of
rays that nearly lie in a triangle's plane and pass its edge.)
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import f32x8, lane, load, maximum, scratch, store
from raystream.structures.bvh.binary_tree import choose_bin_count
from raystream.structures.bvh.binning import BIN_COUNT, block_count
from raystream.structures.bvh.prim_refs import FIRST_AT, REF_BYTES, empty_box, half_area
from raystream.structures.clip import BOUND, clip_to_plane

__all__ = [
    "EXIT_BYTES",
    "PAD",
    "SIDE_AT",
    "SPATIAL_BIN_BYTES",
    "clip_ref",
    "find_plane",
    "is_empty",
]

#: Byte offset of a reference's count, and of its side while a range is split.
SIDE_AT = 28

#: Padding of the clipped boxes at the plane, in units of the scene's largest coordinate: no hit is
#: lost between them by rounding.
PAD = 2.0**-20

_BOUND_PADS = np.float64(BOUND / PAD)
_AXES = np.uint64(3)
_LANE = np.uint64(4)
_HIGH = np.uint64(16)
_BOX_HIGH = np.uint64(12)

#: Most bins per axis.
_BINS = BIN_COUNT
SPATIAL_BIN_BYTES = 3 * _BINS * REF_BYTES
EXIT_BYTES = 3 * _BINS * 4
_COUNT_BYTES = _BINS * 4
_ONE_AXIS = _BINS * REF_BYTES

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)


@device_call
def clip_ref(ref, corners, axis, position, pad, left, right):
    """Clip a reference at a plane: write the parts on both sides.

    Parameters
    ----------
    ref : uint64
        Address of the reference.
    corners : uint64
        Address of all triangles' corners.
    axis : uint64
    position, pad : float32
        The plane, and `PAD` in the scene's unit.
    left, right : uint64
        Where to write them; `empty_box` for an empty part.
    """
    triangle = corners + np.uint64(load(np.int32, ref + np.uint64(FIRST_AT))) * np.uint64(36)
    whole = load(f32x8, ref)
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
    """Tighten a part's box to the triangle's plane; copy prim_id, and set the count to 1."""
    bound = np.float64(pad) * _BOUND_PADS
    grown = scratch(24)
    for axis in range(_AXES):
        at = axis * _LANE
        store(grown + at, np.float32(-load(np.float32, part + at) - bound))
        store(grown + _BOX_HIGH + at, np.float32(load(np.float32, part + _HIGH + at) + bound))
    if clip_to_plane(triangle, bound, grown):
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
        store(part, empty_box())
    store(part + np.uint64(FIRST_AT), lane(whole, 3))
    store(part + np.uint64(SIDE_AT), np.float32(1.0))


@device
def is_empty(box):
    """Whether a reference's box is empty."""
    size = load(f32x8, box)
    empty = False
    for axis in range(np.int32(3)):
        empty = empty or -lane(size, axis) > lane(size, axis + np.int32(4))
    return empty


@device
def _bin_of(x, low, scale, bin_count):
    k = np.int64((x - low) * scale)
    return np.uint64(min(max(k, np.int64(0)), np.int64(bin_count) - np.int64(1)))


@device
def _plane(low, scale, k):
    """The lower plane of bin k."""
    return np.float32(np.float64(low) + np.float64(k) / np.float64(scale))


@device_call
def find_plane(refs, begin, end, box, corners, pad, bins, exits):
    """Find the plane of least cost.

    Returns axis (-1 for no plane), position, cost, and the number of references it cuts.
    """
    for k in range(np.uint64(3 * _BINS)):
        store(bins + k * np.uint64(REF_BYTES), empty_box())
        store(bins + k * np.uint64(REF_BYTES) + np.uint64(SIDE_AT), _ZERO)
        store(exits + k * np.uint64(4), np.int32(0))
    bounds = load(f32x8, box)
    bin_count = choose_bin_count(end - begin)
    rest, part = scratch(REF_BYTES), scratch(REF_BYTES)
    best_axis, best_position, best_cost, best_cut = np.int32(-1), _ZERO, _INF, np.int32(0)
    for axis in range(np.uint64(3)):
        low = -lane(bounds, np.int32(axis))
        extent = lane(bounds, np.int32(axis) + np.int32(4)) - low
        scale = np.float32(bin_count) / extent if extent > _ZERO else _ZERO
        if not (_ZERO < scale < _INF):
            continue
        bin_at = bins + axis * np.uint64(_ONE_AXIS)
        exit_at = exits + axis * np.uint64(_BINS * 4)
        for i in range(np.uint64(begin), np.uint64(end)):
            ref = refs + i * np.uint64(REF_BYTES)
            first = _bin_of(-load(np.float32, ref + axis * np.uint64(4)), low, scale, bin_count)
            last = _bin_of(
                load(np.float32, ref + axis * np.uint64(4) + np.uint64(16)),
                low,
                scale,
                bin_count,
            )
            store(rest, load(f32x8, ref))
            for k in range(first, last):
                clip_ref(rest, corners, axis, _plane(low, scale, k + np.uint64(1)), pad, part, rest)
                to = bin_at + k * np.uint64(REF_BYTES)
                _include(to, part)
            _include(bin_at + last * np.uint64(REF_BYTES), rest)
            entry = bin_at + first * np.uint64(REF_BYTES) + np.uint64(SIDE_AT)
            store(entry, np.float32(load(np.float32, entry) + np.float32(1.0)))
            leave = exit_at + last * np.uint64(4)
            store(leave, np.int32(load(np.int32, leave) + np.int32(1)))
        # Sweep right to left for the costs of the right sides, then left to right.
        costs = scratch(_COUNT_BYTES)
        counts = scratch(_COUNT_BYTES)
        side, count = empty_box(), np.int32(0)
        k = np.uint64(bin_count - 1)
        while k != np.uint64(0):
            side = maximum(side, load(f32x8, bin_at + k * np.uint64(REF_BYTES)))
            count = np.int32(count + load(np.int32, exit_at + k * np.uint64(4)))
            store(costs + k * np.uint64(4), half_area(side) * block_count(count))
            store(counts + k * np.uint64(4), count)
            k -= np.uint64(1)
        side, count = empty_box(), np.int32(0)
        for k in range(np.uint64(1), np.uint64(bin_count)):
            before = bin_at + (k - np.uint64(1)) * np.uint64(REF_BYTES)
            side = maximum(side, load(f32x8, before))
            count = np.int32(count + np.int32(load(np.float32, before + np.uint64(SIDE_AT))))
            right_count = load(np.int32, counts + k * np.uint64(4))
            cost = half_area(side) * block_count(count) + load(np.float32, costs + k * np.uint64(4))
            total = np.int32(end - begin)
            if (
                cost < best_cost
                and count != total
                and right_count != total
                and count != 0
                and right_count != 0
            ):
                best_axis, best_cost = np.int32(axis), cost
                best_position = _plane(low, scale, k)
                best_cut = np.int32(count + right_count - total)
    return best_axis, best_position, best_cost, best_cut


@device
def _include(to, ref):
    """Extend a bin by a box unless that is empty; the count stays."""
    if not is_empty(ref):
        count = load(np.float32, to + np.uint64(SIDE_AT))
        store(to, maximum(load(f32x8, to), load(f32x8, ref)))
        store(to + np.uint64(SIDE_AT), count)
