"""The query for the triangles nearest to a point, around any structure's search.

`kernels.answers` makes a loop and a thread of it. A loop answers the points of a call along a
curve, and begins each search with the triangles that the one before found.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import INVALID, VALID
from raystream.jit.constants import ONE_U64, ZERO_F32, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, prefetch, store
from raystream.jit.threads import thread_count
from raystream.kernels.nearest import (
    ROW,
    TRIANGLES,
    NearestRow,
    RowShape,
    begin_nearest,
    offer_again,
)
from raystream.kernels.point_order import PointOrder, begin_order, load_point, order_bytes, point_at
from raystream.kernels.ray import (
    MOST_COORDINATE,
    SceneFrame,
    are_within,
    largest,
    scaled,
    to_frame,
)
from raystream.kernels.ray_source import loader

_FLOAT, _DOUBLE, _VECTOR = np.uint64(4), np.uint64(8), np.uint64(24)  # bytes
_ROW_BYTES = np.uint64(ROW.itemsize)
_ANSWER_BYTES = 8 + 24 + 4 + 4 + 4  # of a row of the answers
_STATE_BYTES = np.uint64(64)  # of an answer's memory, before the stack
_MISS = np.int32(-1)

#: Points with a larger coordinate in the local frame are invalid: squares of squares must stay
#: finite in float64. In world space, the limit is that of rays.
_FARTHEST_LOCAL = 2.0**240

#: Points that are further from the origin than this many times the scene's largest coordinate are
#: moved that near for the search: float64 would not tell triangles apart there, and each would
#: have to be compared. Distances change their order by this by less than the rounding, 2**-53 of
#: them: the sphere around a point differs by that much from a plane, within the scene.
_NEAREST_FAR = 2.0**26

#: Most points of a call: sorted together, the more the nearer to each other. Fewer than some are
#: not sorted.
POINTS_PER_CALL = 1 << 14
_LEAST_SORTED = 64

#: How far ahead sorted points are prefetched, as they lie anywhere in memory: 1.05 to 1.1
#: times as fast. 4 or 8 gained no more.
_AHEAD = np.uint64(2)

#: The squared limit is larger than the square of the limit by more than the rounding; whether a
#: triangle lies within is decided by its distance.
_SLACK, _TINY = 1.0 + 2.0**-48, 2.0**-1000

#: More than the rounding of a sum, in units of a term: the other's is within that of distances.
_SUM_ROUNDING = 2.0**-52


class PointBatch(NamedTuple):
    """Points in world space, and what is asked of each.

    Attributes
    ----------
    points : ndarray of shape (N, 3), float64
        C-contiguous.
    limits : ndarray of shape (N,) or (1,), float64
        Greatest distances: of each point, or of all.
    capacity : int
        Triangles to find for each.
    """

    points: NDArray[np.float64]
    limits: NDArray[np.float64]
    capacity: int


class NearestArrays(NamedTuple):
    """The answers: `capacity` rows for each of N points, by distance, then prim_id.

    Kernels take the addresses of these arrays, by the same names.

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

    distance: Any
    positions: Any
    u: Any
    v: Any
    prim_id: Any
    status: Any

    @classmethod
    def empty(cls, count: int, capacity: int, make: Callable[..., Any] = np.empty) -> NearestArrays:
        """Uninitialised arrays for `count` points; ``make(shape, dtype)`` allocates one."""
        rows = count * capacity
        return cls(
            make(rows, np.float64),
            make((rows, 3), np.float64),
            make(rows, np.float32),
            make(rows, np.float32),
            make(rows, np.int32),
            make(count, np.uint8),
        )


class PointScene(NamedTuple):
    """The arguments that all points of a query share.

    Attributes
    ----------
    points : uint64
        Address of three float64 a point: world space.
    limits : uint64
        Address of the greatest distance, float64, of the first point or of all.
    limit_step : uint64
        Bytes from a point's limit to the next; 0 if all have the same.
    frame : SceneFrame
    arrays : NamedTuple
        The structure's arrays.
    capacity : uint64
        Triangles for each point.
    rows : uint64
        Address of `capacity` rows of `kernels.nearest.ROW` for each point; with an order, of twice
        as many for all.
    order : PointOrder or None
    """

    points: np.uint64
    limits: np.uint64
    limit_step: np.uint64
    frame: SceneFrame
    arrays: Any
    capacity: np.uint64
    rows: np.uint64
    order: PointOrder | None

    def in_call(self, begin: int, end: int, memory: int) -> PointScene:
        """The scene for a call with an order, and the address of `work_bytes` of memory."""
        of_order = memory + 2 * int(self.capacity) * ROW.itemsize
        order = begin, end, of_order if end - begin >= _LEAST_SORTED else 0
        own = PointOrder._make(map(np.uint64, order))
        return self._replace(rows=np.uint64(memory), order=own)


class PointSearch(NamedTuple):
    """A structure's search for the triangles nearest to a point.

    Attributes
    ----------
    find : device function
        ``find(view, frame, query, search, stack)`` offers the triangles of `view`, the structure's
        `arrays`, that may be among those nearest to a `PointQuery` to the search
        (`kernels.nearest`), and returns it. The search may have found some of them before.
    stack_bytes : int
        Size of the memory at the address `stack`, which is aligned to 64 bytes.
    shape : RowShape
        Of what it finds.
    in_world : bool
        Whether shapes are in world space, in units of the local frame, rather than in that frame.
    """

    find: Callable[..., Any]
    stack_bytes: int
    shape: RowShape = TRIANGLES
    in_world: bool = False


class PointQuery(NamedTuple):
    """A point and what is asked of it.

    Attributes
    ----------
    point : triple of float64
        In the frame of the shapes, see `PointSearch`.
    moved : triple of float64
        The point to search for; see `_NEAREST_FAR`.
    local : triple of float64
        The same in the local frame, that of the boxes.
    slack : float64
        By how much that differs from `moved`.
    is_moved : bool
        Whether it is another one.
    limit : float64
        Greatest distance, world units.
    status : uint8
        A `RayStatus`.
    """

    point: tuple[float, float, float]
    moved: tuple[float, float, float]
    local: tuple[float, float, float]
    slack: float
    is_moved: bool
    limit: float
    status: np.uint8


def step_of(limits: NDArray[np.float64]) -> np.uint64:
    """Bytes from a limit to the next: none if there is only one for all points."""
    return np.uint64(8 if len(limits) > 1 else 0)


def work_bytes(count: int, capacity: int) -> int:
    """Bytes of memory that a call of a loop needs for `count` points."""
    return 2 * capacity * ROW.itemsize + order_bytes(count)


def answer_bytes(count: int, capacity: int) -> int:
    """Most bytes of the answers for `count` points, and of the calls that find them."""
    calls = thread_count() * work_bytes(min(count, POINTS_PER_CALL), capacity)
    return count * capacity * _ANSWER_BYTES + calls


@device
def _to_local(point, frame):
    """A point in the local frame, and its status."""
    local = to_frame(point, frame)
    is_valid = are_within(point, MOST_COORDINATE) and are_within(local, _FARTHEST_LOCAL)
    return local, VALID if is_valid else INVALID


#: ``_load_local(points, i, frame)``: point i, and its status.
_load_local = loader(load_point, _to_local)

#: ``_load_scaled(points, i, scale)``: point i of world space, in local units.
_load_scaled = loader(load_point, scaled)


@device
def _moved(point, frame):
    """The point to search for, and whether it is another one; see `_NEAREST_FAR`."""
    reach, most = largest(point), _NEAREST_FAR * np.float64(frame.max_coordinate)
    if reach <= most:
        return point, False
    return scaled(point, most / reach), True


@device
def _length(p, q):
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    return math.sqrt(x * x + y * y + z * z)


@device
def _read_point(scene, i):
    """Read point i of a `PointScene`; a `PointQuery`."""
    limit = load(np.float64, scene.limits + i * scene.limit_step)
    point, status = _load_local(scene.points, i, scene.frame)
    moved, is_moved = _moved(point, scene.frame)
    return PointQuery(point, moved, moved, ZERO_F64, is_moved, limit, status)


@device
def _in_world(query, points, i, frame):
    """The query of point i for shapes in world space."""
    point, moved = _load_scaled(points, i, frame.scale), query.moved
    center, slack, is_moved = scaled(frame.center, frame.scale), ZERO_F64, query.is_moved
    if is_moved:
        moved = moved[0] + center[0], moved[1] + center[1], moved[2] + center[2]
        slack = _SUM_ROUNDING * largest(center)
    else:
        moved = point
    return PointQuery(point, moved, query.local, slack, is_moved, query.limit, query.status)


@device
def _begin_point(query, frame, rows, capacity):
    """Begin the search for a point's nearest triangles; see `kernels.nearest.begin_nearest`."""
    within = np.inf if query.is_moved else query.limit * frame.scale
    return begin_nearest(rows, capacity, within * within * _SLACK + _TINY)


@device
def _write(out, row, distance, position, weights, prim_id):
    """Write a row of `NearestArrays`."""
    store(out.distance + row * _DOUBLE, distance)
    at = out.positions + row * _VECTOR
    store(at, position[0])
    store(at + _DOUBLE, position[1])
    store(at + (_DOUBLE + _DOUBLE), position[2])
    store(out.u + row * _FLOAT, weights[0])
    store(out.v + row * _FLOAT, weights[1])
    store(out.prim_id + row * _FLOAT, prim_id)


@device
def _write_missing(out, row):
    _write(out, row, np.inf, (np.nan, np.nan, np.nan), (ZERO_F32, ZERO_F32), _MISS)


@device
def _write_found(out, row, prim_id, foot, query, least, frame, center):
    """Write the triangle of a row, if it is within the limit.

    Parameters
    ----------
    out : NearestArrays
    row : uint64
    prim_id : int32
    foot : Foot
    query : PointQuery
    least : float64
        Distance of the row before.
    frame : SceneFrame
    center : triple of float64
        World position of the origin of the foot's frame.

    Returns
    -------
    float64
        The distance.
    """
    distance = math.sqrt(foot.squared) * frame.inverse_scale
    if query.is_moved:
        distance = _length(query.point, (foot.x, foot.y, foot.z)) * frame.inverse_scale
        distance = max(distance, least)
    if not distance <= query.limit:
        _write_missing(out, row)
        return np.inf
    position = (
        foot.x * frame.inverse_scale + center[0],
        foot.y * frame.inverse_scale + center[1],
        foot.z * frame.inverse_scale + center[2],
    )
    weights = np.float32(foot.u), np.float32(foot.v)
    _write(out, row, distance, position, weights, prim_id)
    return distance


@device
def _rows_of(order, i, scene, memory):
    """Where the rows of a point are, those of the previous point, and how many it has."""
    size = scene.capacity * _ROW_BYTES
    if order is None:
        own = scene.rows + i * size
        return own, own, ZERO_U64
    # Twice the number of these rows, and whether they are the second ones.
    state = load(np.uint64, memory)
    side = (state & ONE_U64) * size
    return scene.rows + (size - side), scene.rows + side, state >> ONE_U64


@device
def _keep_rows(order, memory, count):
    """Note the rows of a point for the next one."""
    if order is not None:
        side = ~load(np.uint64, memory) & ONE_U64
        store(memory, (count << ONE_U64) | side)


def nearest_answer(search: PointSearch) -> tuple[Callable[..., None], int]:
    """Make the query of a structure's search: an answer and its memory, see `kernels.answers`.

    The answer takes a `PointScene` and writes `NearestArrays`.
    """
    find, stack_bytes, shape, in_world = search
    again, foot_of_row = offer_again(shape.measure), shape.foot

    @device
    def write_nearest(out, i, query, rows, found_count, scene):
        """Write the answer of point i from the address of the rows that the search found."""
        store(out.status + i, query.status)
        distance, frame = 0.0, scene.frame
        center = (0.0, 0.0, 0.0) if in_world else frame.center
        for k in range(scene.capacity):
            at = i * scene.capacity + k
            if k < found_count:
                row = NearestRow(rows, k)
                foot = foot_of_row(scene.arrays, frame, query.moved, row)
                prim_id = row.prim_id
                distance = _write_found(out, at, prim_id, foot, query, distance, frame, center)
            else:
                _write_missing(out, at)

    @device
    def find_nearest(i, scene, out, memory):
        frame, capacity, order = scene.frame, scene.capacity, scene.order
        begin_order(order, scene.points, i)
        # Points that are sorted lie anywhere in memory. Numbers after the last are of no point.
        prefetch(scene.points + point_at(order, i + _AHEAD) * _VECTOR)
        number = point_at(order, i)
        query = _read_point(scene, number)
        if in_world:
            query = _in_world(query, scene.points, number, frame)
        rows, others, known = _rows_of(order, i, scene, memory)
        found = ZERO_U64
        if query.status == VALID:
            nearest = _begin_point(query, frame, rows, capacity)
            nearest = again(nearest, scene.arrays, frame, query.moved, others, known)
            nearest = find(scene.arrays, frame, query, nearest, memory + _STATE_BYTES)
            found = nearest.found_count
            _keep_rows(order, memory, found)
        write_nearest(out, number, query, rows, found, scene)

    return find_nearest, int(_STATE_BYTES) + stack_bytes
