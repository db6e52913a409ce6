"""The loop over points, around any structure's search for the nearest triangles."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayStatus
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, load, scratch
from raystream.kernels.nearest import (
    ROW,
    NearestRow,
    begin_nearest,
    corners_at,
    offer_again,
)
from raystream.kernels.point_order import ORDER_WORDS, WORDS_PER_POINT, order_points
from raystream.kernels.point_triangle import foot_on_triangle

__all__ = ["NearestArrays", "PointSource", "point_queries", "work_bytes"]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # four bytes, as a shift
_ROW_BYTES = np.uint64(ROW.itemsize)
_VALID = np.uint8(RayStatus.VALID)
_INVALID = np.uint8(RayStatus.INVALID)
_MISS = np.int32(-1)
_ZERO = np.float32(0.0)

#: Points with a larger coordinate are invalid: in world space, as for rays, and in the local
#: frame, where squares of squares must stay finite in float64.
_FARTHEST = 2.0**200
_FARTHEST_LOCAL = 2.0**240

#: Fewer points are not sorted.
_LEAST_SORTED = np.uint64(64)

#: The squared limit is larger than the square of the limit by more than the rounding; whether a
#: triangle lies within is decided by its distance.
_SLACK, _TINY = 1.0 + 2.0**-48, 2.0**-1000


class PointSource(NamedTuple):
    """The points of a query, in world space.

    Attributes
    ----------
    points : ndarray of shape (N, 3), float64
        C-contiguous.
    limits : ndarray of shape (N,) or (1,), float64
        Greatest distance of each point, or of all.
    """

    points: NDArray[np.float64]
    limits: NDArray[np.float64]


class NearestArrays(NamedTuple):
    """The answers: `capacity` rows for each of N points, by distance, then prim_id.

    Attributes
    ----------
    distance : ndarray of shape (N * capacity,), float64
        inf for rows without a triangle.
    positions : ndarray of shape (N * capacity, 3), float64
        World space; NaN for rows without a triangle.
    u, v : ndarray of shape (N * capacity,), float32
    prim_id : ndarray of shape (N * capacity,), int32
        -1 for rows without a triangle.
    status : ndarray of shape (N,), uint8
        A `RayStatus`.
    """

    distance: NDArray[np.float64]
    positions: NDArray[np.float64]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    prim_id: NDArray[np.int32]
    status: NDArray[np.uint8]

    @classmethod
    def empty(cls, count: int, capacity: int) -> NearestArrays:
        """Uninitialised arrays for `count` points."""
        rows = count * capacity
        return cls(
            np.empty(rows),
            np.empty((rows, 3)),
            np.empty(rows, np.float32),
            np.empty(rows, np.float32),
            np.empty(rows, np.int32),
            np.empty(count, np.uint8),
        )


def work_bytes(count: int, capacity: int) -> int:
    """Bytes of memory that a call of the loop needs for `count` points."""
    return 2 * capacity * ROW.itemsize + 4 * (WORDS_PER_POINT * count + ORDER_WORDS)


@device
def _local(source, i, frame):
    """Point i in the local frame, and its status."""
    x, y, z = source.points[i, 0], source.points[i, 1], source.points[i, 2]
    world = max(max(abs(x), abs(y)), abs(z))
    is_number = abs(x) <= _FARTHEST and abs(y) <= _FARTHEST and abs(z) <= _FARTHEST
    x = (x - frame.center[0]) * frame.scale
    y = (y - frame.center[1]) * frame.scale
    z = (z - frame.center[2]) * frame.scale
    local = max(max(abs(x), abs(y)), abs(z))
    is_valid = is_number and world <= _FARTHEST and local <= _FARTHEST_LOCAL
    return (x, y, z), _VALID if is_valid else _INVALID


@device
def _write_missing(out, row):
    out.distance[row] = np.inf
    out.positions[row, 0] = np.nan
    out.positions[row, 1] = np.nan
    out.positions[row, 2] = np.nan
    out.u[row] = _ZERO
    out.v[row] = _ZERO
    out.prim_id[row] = _MISS


@device
def _write_found(out, row, found, point, limit, frame):
    """Write the triangle of a row, if it is within the limit."""
    a, b, c = corners_at(found.place, found.stride)
    foot = foot_on_triangle(point, a, b, c)
    distance = math.sqrt(foot.squared) * frame.inverse_scale
    if not distance <= limit:
        _write_missing(out, row)
        return
    out.distance[row] = distance
    out.positions[row, 0] = foot.x * frame.inverse_scale + frame.center[0]
    out.positions[row, 1] = foot.y * frame.inverse_scale + frame.center[1]
    out.positions[row, 2] = foot.z * frame.inverse_scale + frame.center[2]
    out.u[row] = np.float32(foot.u)
    out.v[row] = np.float32(foot.v)
    out.prim_id[row] = found.prim_id


def point_queries(find: Callable[..., Any], stack_bytes: int) -> Callable[..., None]:
    """Make the loop over points with a structure's search.

    Parameters
    ----------
    find : device function
        ``find(view, frame, point, search, stack)`` offers the triangles of `view`, the structure's
        `arrays`, that may be among those nearest to `point`, a triple of float64 in the local
        frame, to the search (`kernels.nearest`), and returns it. The search may have found some of
        them before.
    stack_bytes : int
        Size of the memory at the address `stack`, which is aligned to 64 bytes; at least 8.

    Returns
    -------
    kernel
        ``find_nearest(begin, end, source, frame, arrays, capacity, work, out)``: of points begin
        to end of a `PointSource` writes the `capacity` nearest triangles to `NearestArrays`.
        `work` is an array of `work_bytes` bytes.
    """

    @kernel
    def find_nearest(begin, end, source, frame, arrays, capacity, work, out):
        first, last, wanted = np.uint64(begin), np.uint64(end), np.uint64(capacity)
        stack = scratch(stack_bytes)
        rows, others = address(work), address(work) + wanted * _ROW_BYTES
        known = _NONE  # rows of the previous point
        is_sorted = last - first >= _LEAST_SORTED
        order = _NONE
        if is_sorted:
            order = order_points(source.points, first, last, others + wanted * _ROW_BYTES)
        for number in range(last - first):
            i = first + number
            if is_sorted:
                i = first + np.uint64(load(np.uint32, order + (number << _WORD)))
            limit = source.limits[i if len(source.limits) > 1 else _NONE]
            point, status = _local(source, i, frame)
            out.status[i] = status
            found = _NONE
            if status == _VALID:
                within = limit * frame.scale
                search = begin_nearest(rows, wanted, within * within * _SLACK + _TINY)
                search = offer_again(search, point, others, known)
                search = find(arrays, frame, point, search, stack)
                found = search.found_count
                known = found
                rows, others = others, rows
            for k in range(wanted):
                if k < found:
                    row = NearestRow(others, k)
                    _write_found(out, i * wanted + k, row, point, limit, frame)
                else:
                    _write_missing(out, i * wanted + k)

    return find_nearest
