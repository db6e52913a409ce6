"""Finding the plane at which a range is split in space: slabs along each axis, and their cost."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    f32x8,
    lane,
    load,
    maximum,
    scratch,
    store,
)
from raystream.structures.bvh.binning import BIN_COUNT, block_count
from raystream.structures.bvh.cut import SIDE_AT, cut_record
from raystream.structures.bvh.records import RECORD_BYTES, half_area, no_box
from raystream.structures.bvh.tree import choose_bin_count

__all__ = ["EXIT_BYTES", "SLAB_BYTES", "find_plane", "is_empty"]

#: Most slabs between planes, along each axis.
_SLABS = BIN_COUNT
SLAB_BYTES = 3 * _SLABS * RECORD_BYTES
EXIT_BYTES = 3 * _SLABS * 4
_COUNT_BYTES = _SLABS * 4
_ONE_AXIS = _SLABS * RECORD_BYTES

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)


@device
def is_empty(box):
    """Whether a record's box holds nothing."""
    size = load(f32x8, box)
    empty = False
    for axis in range(np.int32(3)):
        empty = empty or -lane(size, axis) > lane(size, axis + np.int32(4))
    return empty


@device
def _slab_of(x, low, scale, slab_count):
    slab = np.int64((x - low) * scale)
    return np.uint64(min(max(slab, np.int64(0)), np.int64(slab_count) - np.int64(1)))


@device
def _plane(low, scale, k):
    """Where slab k begins."""
    return np.float32(np.float64(low) + np.float64(k) / np.float64(scale))


@device_call
def find_plane(records, begin, end, box, corners, pad, slabs, exits):
    """Find the best plane; returns axis (-1 if none), position, cost and cut records."""
    for k in range(np.uint64(3 * _SLABS)):
        store(slabs + k * np.uint64(RECORD_BYTES), no_box())
        store(slabs + k * np.uint64(RECORD_BYTES) + np.uint64(SIDE_AT), _ZERO)
        store(exits + k * np.uint64(4), np.int32(0))
    bounds = load(f32x8, box)
    slab_count = choose_bin_count(end - begin)
    rest, part = scratch(RECORD_BYTES), scratch(RECORD_BYTES)
    best_axis, best_position, best_cost, best_cut = np.int32(-1), _ZERO, _INF, np.int32(0)
    for axis in range(np.uint64(3)):
        low = -lane(bounds, np.int32(axis))
        extent = lane(bounds, np.int32(axis) + np.int32(4)) - low
        scale = np.float32(slab_count) / extent if extent > _ZERO else _ZERO
        if not (_ZERO < scale < _INF):
            continue
        slab_at = slabs + axis * np.uint64(_ONE_AXIS)
        exit_at = exits + axis * np.uint64(_SLABS * 4)
        for i in range(np.uint64(begin), np.uint64(end)):
            record = records + i * np.uint64(RECORD_BYTES)
            first = _slab_of(
                -load(np.float32, record + axis * np.uint64(4)), low, scale, slab_count
            )
            last = _slab_of(
                load(np.float32, record + axis * np.uint64(4) + np.uint64(16)),
                low,
                scale,
                slab_count,
            )
            store(rest, load(f32x8, record))
            for k in range(first, last):
                cut_record(
                    rest, corners, axis, _plane(low, scale, k + np.uint64(1)), pad, part, rest
                )
                to = slab_at + k * np.uint64(RECORD_BYTES)
                _include(to, part)
            _include(slab_at + last * np.uint64(RECORD_BYTES), rest)
            entry = slab_at + first * np.uint64(RECORD_BYTES) + np.uint64(SIDE_AT)
            store(entry, np.float32(load(np.float32, entry) + np.float32(1.0)))
            leave = exit_at + last * np.uint64(4)
            store(leave, np.int32(load(np.int32, leave) + np.int32(1)))
        # Right to left, costs of the right side; then left to right.
        costs = scratch(_COUNT_BYTES)
        counts = scratch(_COUNT_BYTES)
        side, count = no_box(), np.int32(0)
        k = np.uint64(slab_count - 1)
        while k != np.uint64(0):
            side = maximum(side, load(f32x8, slab_at + k * np.uint64(RECORD_BYTES)))
            count = np.int32(count + load(np.int32, exit_at + k * np.uint64(4)))
            store(costs + k * np.uint64(4), half_area(side) * block_count(count))
            store(counts + k * np.uint64(4), count)
            k -= np.uint64(1)
        side, count = no_box(), np.int32(0)
        for k in range(np.uint64(1), np.uint64(slab_count)):
            before = slab_at + (k - np.uint64(1)) * np.uint64(RECORD_BYTES)
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
def _include(to, record):
    """Include a box that is not empty; the count stays."""
    if not is_empty(record):
        count = load(np.float32, to + np.uint64(SIDE_AT))
        store(to, maximum(load(f32x8, to), load(f32x8, record)))
        store(to + np.uint64(SIDE_AT), count)
