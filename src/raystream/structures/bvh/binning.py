"""Binned SAH: where to split a range of primitive references."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    f32x4,
    f32x8,
    i32x4,
    lane,
    lanes_from_bits,
    load,
    mask4,
    select,
    store,
)
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.bvh.prim_refs import (
    REF_BYTES,
    empty_bin,
    half_area,
    high_half,
    low_half,
    union,
)

__all__ = [
    "BINS_BYTES",
    "BIN_COUNT",
    "SUMS_BYTES",
    "bin_frame",
    "bin_refs",
    "block_count",
    "clear_bins",
    "find_split",
]

#: Most bins per axis. 16 find splits within a few per cent of an exact sweep's cost.
BIN_COUNT = 16

#: Bins: a box for each bin, axis after axis.
_AXIS_BYTES = BIN_COUNT * REF_BYTES
BINS_BYTES = 3 * _AXIS_BYTES

#: Costs of `find_split`'s sweep from the right, one per bin.
SUMS_BYTES = BIN_COUNT * 4

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_QUARTER = np.float32(0.25)

#: Most references whose leaf blocks are counted; those of more are estimated.
_FEW = np.int32(8)


@device
def bin_frame(centroids, bin_count):
    """Start and scale of the bins of each axis, in units of twice the centroid.

    The scale is 0 on an axis that cannot be split: all centroids are the same there.
    """
    low, high = low_half(centroids), high_half(centroids)
    # Lane 3 has the bits of a prim_id: replace them by a normal number, since arithmetic on
    # subnormal ones is slow.
    three, one = lanes_from_bits(mask4, 7), f32x4(np.float32(1.0))
    extent = select(three, low + high, one)
    # Slightly less than the count, so that the last centroid falls into the last bin. A
    # subnormal extent has no finite reciprocal: such an axis is not split.
    scale = f32x4(np.float32(0.9999) * np.float32(bin_count)) / extent
    scale = select(extent > _ZERO, scale, f32x4(_ZERO))
    scale = select(scale < _INF, scale, f32x4(_ZERO))
    return select(three, f32x4(_ZERO) - low, one), scale


@device
def clear_bins(bins, bin_count):
    """Empty the first bins of each axis."""
    for k in range(np.uint64(bin_count)):
        at = bins + k * np.uint64(REF_BYTES)
        store(at, empty_bin())
        store(at + np.uint64(_AXIS_BYTES), empty_bin())
        store(at + np.uint64(2 * _AXIS_BYTES), empty_bin())


@device
def bin_refs(at, end, start, scale, bins):
    """Add the references from address `at` to `end` to the bins of all three axes."""
    while at != end:
        ref = load(f32x8, at)
        places = i32x4((high_half(ref) - low_half(ref) - start) * scale)
        for axis in range(np.uint64(3)):
            to = bins + axis * np.uint64(_AXIS_BYTES)
            to += np.uint64(lane(places, axis)) * np.uint64(REF_BYTES)
            store(to, union(load(f32x8, to), ref))
        at += np.uint64(REF_BYTES)


@device
def block_count(ref_count):
    """Leaf blocks for a number of triangles, as float32."""
    return np.float32((np.int32(ref_count) + np.int32(BLOCK_SIZE - 1)) >> np.int32(2))


@device
def _cost(box):
    count = np.int32(lane(box, 7))
    # Of many references as if leaves were less than full: rounded up at any number, counts have two
    # sides at odds with a good place, and a wall shares a leaf with what stands before it.
    many = np.float32(count + np.int32(2)) * _QUARTER
    return half_area(box) * (block_count(count) if count <= _FEW else many)


@device_call
def find_split(bins, bin_count, sums):
    """Find the split with the least SAH cost: area times leaf blocks, summed over both sides.

    Parameters
    ----------
    bins : uint64
        Address of filled bins.
    bin_count : int
    sums : uint64
        Address of SUMS_BYTES of scratch.

    Returns
    -------
    axis, position : int32
        References in bins below `position` go left; axis is -1 if no split separates any.
    """
    best_axis, best_position, best_cost = np.int32(-1), np.int32(0), _INF
    for axis in range(np.int32(3)):
        boxes = bins + np.uint64(axis) * np.uint64(_AXIS_BYTES)
        side = empty_bin()
        k = np.uint64(bin_count - 1)
        while k != np.uint64(0):
            side = union(side, load(f32x8, boxes + k * np.uint64(REF_BYTES)))
            store(sums + k * np.uint64(4), _cost(side))
            k -= np.uint64(1)
        side = empty_bin()
        while k != np.uint64(bin_count - 1):
            side = union(side, load(f32x8, boxes + k * np.uint64(REF_BYTES)))
            k += np.uint64(1)
            # The cost of an empty side is NaN: infinity times zero.
            cost = _cost(side) + load(np.float32, sums + k * np.uint64(4))
            if cost < best_cost:
                best_axis, best_position, best_cost = axis, np.int32(k), cost
    return best_axis, best_position
