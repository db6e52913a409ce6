"""Choosing where to split a set of triangles: the surface area heuristic over bins."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call

__all__ = ["BIN_COUNT", "bounds_of", "find_split", "half_area", "partition"]

#: Bins along each axis. 16 find splits within a few per cent of an exact sweep's cost.
BIN_COUNT = 16

_INF = np.float32(np.inf)


@device
def half_area(box):
    """Half the surface of a box of shape (2, 3); zero for an empty one."""
    x = box[1, 0] - box[0, 0]
    y = box[1, 1] - box[0, 1]
    z = box[1, 2] - box[0, 2]
    if x < 0.0:
        return np.float32(0.0)
    return x * y + y * z + z * x


@device
def _clear(box):
    for axis in range(3):
        box[0, axis] = _INF
        box[1, axis] = -_INF


@device
def _include(box, other):
    for axis in range(3):
        box[0, axis] = min(box[0, axis], other[0, axis])
        box[1, axis] = max(box[1, axis], other[1, axis])


@device
def _middle(box, axis):
    """Twice the middle of a box."""
    return box[0, axis] + box[1, axis]


@device_call
def bounds_of(boxes, begin, end, bounds, middles):
    """Bounds of the boxes begin to end, and of twice their middles."""
    _clear(bounds)
    _clear(middles)
    for i in range(np.uint64(begin), np.uint64(end)):
        box = boxes[i]
        _include(bounds, box)
        for axis in range(3):
            middle = _middle(box, axis)
            middles[0, axis] = min(middles[0, axis], middle)
            middles[1, axis] = max(middles[1, axis], middle)


@device
def _bin_scale(middles, axis):
    """Bins in a unit of twice the middle; 0 where all middles are the same."""
    extent = middles[1, axis] - middles[0, axis]
    # Slightly less than BIN_COUNT, so that the last middle falls into the last bin. A
    # subnormal extent has no finite reciprocal: such an axis is not split.
    scale = np.float32(BIN_COUNT * 0.9999) / extent if extent > 0.0 else np.float32(0.0)
    return scale if scale < _INF else np.float32(0.0)


@device
def _bin_of(box, axis, middles, scale):
    return np.int64((_middle(box, axis) - middles[0, axis]) * scale)


@device_call
def find_split(boxes, begin, end, middles, bin_boxes, bin_counts, right_costs):
    """Find the split of least cost: sum over both sides of area times triangles.

    Parameters
    ----------
    boxes : ndarray of shape (A, 2, 3), float32
    begin, end : int
        Which of them to split.
    middles : ndarray of shape (2, 3), float32
        Bounds of twice their middles.
    bin_boxes, bin_counts, right_costs : ndarray
        Scratch, of shapes (3, BIN_COUNT, 2, 3), (3, BIN_COUNT) and (BIN_COUNT,).

    Returns
    -------
    axis, position : int
        Boxes in bins below `position` go left; axis is -1 if no split separates anything.
    cost : float32
    """
    # Step 1: one pass over the boxes fills the bins of all three axes.
    for axis in range(3):
        for k in range(BIN_COUNT):
            bin_counts[axis, k] = 0
            _clear(bin_boxes[axis, k])
    scale_x = _bin_scale(middles, 0)
    scale_y = _bin_scale(middles, 1)
    scale_z = _bin_scale(middles, 2)
    for i in range(np.uint64(begin), np.uint64(end)):
        box = boxes[i]
        k = _bin_of(box, 0, middles, scale_x)
        bin_counts[0, k] += 1
        _include(bin_boxes[0, k], box)
        k = _bin_of(box, 1, middles, scale_y)
        bin_counts[1, k] += 1
        _include(bin_boxes[1, k], box)
        k = _bin_of(box, 2, middles, scale_z)
        bin_counts[2, k] += 1
        _include(bin_boxes[2, k], box)

    # Step 2: sweep the bins from the right, then from the left.
    best_axis, best_position, best_cost = -1, 0, _INF
    side = np.empty((2, 3), np.float32)
    for axis in range(3):
        _clear(side)
        count = 0
        for k in range(BIN_COUNT - 1, 0, -1):
            _include(side, bin_boxes[axis, k])
            count += bin_counts[axis, k]
            right_costs[k] = half_area(side) * np.float32(count)
        total = count + bin_counts[axis, 0]
        _clear(side)
        count = 0
        for k in range(1, BIN_COUNT):
            _include(side, bin_boxes[axis, k - 1])
            count += bin_counts[axis, k - 1]
            if count == 0 or count == total:
                continue
            cost = half_area(side) * np.float32(count) + right_costs[k]
            if cost < best_cost:
                best_axis, best_position, best_cost = axis, k, cost
    return best_axis, best_position, best_cost


@device_call
def partition(boxes, prim_ids, begin, end, middles, axis, position):
    """Move the boxes of bins below `position` to the front, in place; returns where they end."""
    scale = _bin_scale(middles, axis)
    left, right = begin, end - 1
    while True:
        while left <= right and _bin_of(boxes[left], axis, middles, scale) < position:
            left += 1
        while left <= right and _bin_of(boxes[right], axis, middles, scale) >= position:
            right -= 1
        if left >= right:
            return left
        for side in range(2):
            for k in range(3):
                boxes[left, side, k], boxes[right, side, k] = (
                    boxes[right, side, k],
                    boxes[left, side, k],
                )
        prim_ids[left], prim_ids[right] = prim_ids[right], prim_ids[left]
