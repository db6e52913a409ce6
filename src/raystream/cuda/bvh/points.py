"""The nearest triangles of a point in binary nodes; see `structures.bvh.nearest` for the bounds."""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.binary import STACK_BYTES
from raystream.cuda.bvh.binary_traversal import binary_walk, one_tree
from raystream.cuda.bvh.triangles import TRIANGLE, TRIANGLE_ID, is_last
from raystream.jit.cpu import device
from raystream.jit.simd import fma, load
from raystream.kernels.nearest import corners_at, is_wanted, offer_nearest
from raystream.kernels.point_queries import PointSearch
from raystream.kernels.point_triangle import squared_distance
from raystream.structures.bvh import nearest

_STRIDE = np.int32(4)  # from one number of a triangle to the next


@device
def _interval(line, search):
    return nearest.ZERO, nearest.limit_of(search)


@device
def _gap(low, high, below, above, zero):
    """How far a point between `below` and `above` is at least from an interval."""
    return max(max(low - above, below - high), zero)


@device
def _enter(box, line, search, _near, far):
    """The least squared distance of a child's box, and whether it is within the limit."""
    x, y, z = line.point
    low_x, high_x, low_y, high_y, low_z, high_z = box
    if line.is_far:
        x = _gap(np.float64(low_x), np.float64(high_x), x, x, nearest.ZERO64)
        y = _gap(np.float64(low_y), np.float64(high_y), y, y, nearest.ZERO64)
        z = _gap(np.float64(low_z), np.float64(high_z), z, z, nearest.ZERO64)
        squared = (x * x + y * y + z * z) * nearest.SHRINK64
        return np.float32(squared), squared <= search.limit
    below, above = line.below, line.above
    x = _gap(low_x, high_x, below[0], above[0], nearest.ZERO)
    y = _gap(low_y, high_y, below[1], above[1], nearest.ZERO)
    z = _gap(low_z, high_z, below[2], above[2], nearest.ZERO)
    squared = max(fma(x * x + y * y + z * z, nearest.SHRINK, nearest.LOSS), nearest.ZERO)
    return squared, squared <= far
