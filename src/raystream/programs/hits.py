"""Hit, the argument of programs, and how it is read from the rows of a query."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.constants import BYTES_32, ONE_U64, ZERO_F64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.hits import HitArrays
from raystream.kernels.intervals import halvings_of, interval_of
from raystream.kernels.ray_source import RaySource
from raystream.kernels.search import ROW_NUMBER, ROW_SHIFT

_NOWHERE = np.uint64(0)
_ENDED = np.uint8(0)
_LONG = np.uint64(8)
_VECTOR = np.uint64(12)
_TRIANGLE = np.uint64(36)
_NO_INSTANCE = np.int32(0)


class Hit(NamedTuple):
    """A hit, as an argument of a program. Unused fields are not computed.

    Attributes
    ----------
    ray : int64
        Index of the ray in the flattened batch.
    t, u, v : float32, or float64 with precision="float64"
        Distance in direction lengths, and weights of vertices 1 and 2; or where on a sphere the hit
        is, see `Hits`.
    prim_id, mesh_id : int32
        Triangle or sphere, counted over the whole scene, and its mesh.
    is_entering : bool
        Whether the ray comes from the front of the triangle, where its vertices run
        counter-clockwise: whether it enters a closed mesh here. An instance that mirrors its object
        keeps the front outside. Of a sphere, whether the ray enters it here.
    instance_id : int32
        The instance that is hit; 0 in a scene without instances.
    """

    ray: int
    t: float
    u: float
    v: float
    prim_id: int
    mesh_id: int
    is_entering: bool
    instance_id: int


class RowsAt(NamedTuple):
    """Addresses of the rows of a query's hits; the caller keeps them alive.

    Attributes
    ----------
    t, u, v, prim_id : uint64
        Addresses of the columns.
    splits : uint64
        Address of the first row of each entry, int64; 0 if row i is entry i's hit or miss.
    counts : uint64
        Address of the number of rows of each entry, int64; 0 if they end at the next entry's.
    delivered : uint64
        Rows of each ray that the program has seen before.
    """

    t: np.uint64
    u: np.uint64
    v: np.uint64
    prim_id: np.uint64
    splits: np.uint64
    counts: np.uint64
    delivered: np.uint64

    @classmethod
    def of(cls, hits: HitArrays, splits: NDArray[np.int64] | None, delivered: int) -> RowsAt:
        """Addresses of rows; without `splits` there is one per ray."""
        places = (*map(_place, hits), _place(splits), 0, delivered)
        return cls(*np.array(places, np.uint64))

    @classmethod
    def nowhere(cls) -> RowsAt:
        """No rows."""
        return cls(*np.zeros(7, np.uint64))


class SceneAt(NamedTuple):
    """Addresses of triangles; the caller keeps the arrays alive.

    Attributes
    ----------
    corners, mesh_splits : uint64
        Addresses of `Triangles.corners` and `Triangles.mesh_splits`.
    mesh_count : uint64
    halvings : uint64
        Steps of the binary search for a mesh.
    """

    corners: np.uint64
    mesh_splits: np.uint64
    mesh_count: np.uint64
    halvings: np.uint64

    @classmethod
    def of(cls, triangles: Triangles) -> tuple[SceneAt, tuple[NDArray[Any], ...]]:
        """Addresses of triangles, and the arrays to keep alive: the triangles may free theirs."""
        kept = triangles.corners, triangles.mesh_splits
        corners, splits = (array.ctypes.data for array in kept)
        return cls.at(corners, splits, len(triangles.mesh_splits) - 1), kept

    @classmethod
    def at(cls, corners: int, mesh_splits: int, mesh_count: int) -> SceneAt:
        """Triangles of `mesh_count` meshes at these addresses."""
        places = corners, mesh_splits, mesh_count, halvings_of(mesh_count)
        return cls(*np.array(places, np.uint64))


class RaysAt(NamedTuple):
    """The rays of a part's entries, and addresses of their directions.

    Attributes
    ----------
    positions : uint64
        Address of the entries' positions among the rays traced; 0 if they are consecutive.
    positions_are_short : bool
        Whether they are int32, else int64.
    start : uint64
        The first position, if they are consecutive.
    ids : uint64
        Address of the batch indices of the rays traced, int64; 0 if they are consecutive.
    first : uint64
        The first index, if they are consecutive.
    directions, direction_step : uint64
    directions_are_double : bool
        See `RaySource`; of the rays traced.
    """

    positions: np.uint64
    positions_are_short: bool
    start: np.uint64
    ids: np.uint64
    first: np.uint64
    directions: np.uint64
    direction_step: np.uint64
    directions_are_double: bool

    @classmethod
    def of(
        cls,
        source: RaySource,
        ids: NDArray[np.int64] | None,
        first: int,
        positions: NDArray[np.int64] | NDArray[np.int32] | None,
        start: int,
    ) -> RaysAt:
        """Addresses of the rays of a source."""
        places = _place(positions), start, _place(ids), first
        at, start_at, ids_at, first_at = np.array(places, np.uint64)
        are_short = positions is not None and positions.itemsize == 4
        directions = source.directions, source.direction_step, source.directions_are_double
        return cls(at, are_short, start_at, ids_at, first_at, *directions)

    @classmethod
    def nowhere(cls) -> RaysAt:
        """No rays."""
        zero = np.uint64(0)
        return cls(zero, False, zero, zero, zero, zero, zero, False)


def _place(array: NDArray[Any] | None) -> int:
    return 0 if array is None else array.ctypes.data


@device
def position_at(rays, i):
    """Position of entry i's ray among those traced."""
    if rays.positions == _NOWHERE:
        return rays.start + i
    if rays.positions_are_short:
        return np.uint64(load(np.int32, rays.positions + i * BYTES_32))
    return np.uint64(load(np.int64, rays.positions + i * _LONG))


@device
def ray_at(rays, position):
    """Batch index of a ray that was traced."""
    if rays.ids == _NOWHERE:
        return rays.first + position
    return np.uint64(load(np.int64, rays.ids + position * _LONG))


@device
def is_open(open_rays, position):
    """Whether a ray is open: no program has ended it."""
    return load(np.uint8, open_rays + position) != _ENDED


@device
def close_ray(open_rays, position):
    """End a ray."""
    store(open_rays + position, _ENDED)


@device
def row_range(rows, i):
    """The new rows of entry i: first and end."""
    if rows.splits == _NOWHERE:
        if load(np.int32, rows.prim_id + i * BYTES_32) < 0:
            return i, i
        return i, i + ONE_U64
    at = rows.splits + i * _LONG
    first, end = np.uint64(load(np.int64, at)), np.uint64(load(np.int64, at + _LONG))
    if rows.counts != _NOWHERE:
        end = first + np.uint64(load(np.int64, rows.counts + i * _LONG))
    return min(first + rows.delivered, end), end


@device
def columns_at(rows, row):
    """t, u, v and prim_id of a row."""
    at = row << ROW_SHIFT
    return (
        load(ROW_NUMBER, rows.t + at),
        load(ROW_NUMBER, rows.u + at),
        load(ROW_NUMBER, rows.v + at),
        load(np.int32, rows.prim_id + row * BYTES_32),
    )


@device
def hit_of(ray, t, u, v, prim_id, rays, position, scene):
    """A `Hit` of the ray at a position among those traced; `ray` is its batch index."""
    mesh = interval_of(scene.mesh_splits, scene.mesh_count, scene.halvings, np.int64(prim_id))
    corners = scene.corners + np.uint64(prim_id) * _TRIANGLE
    is_entering = faces_front(corners, direction_at(rays, position))
    return Hit(np.int64(ray), t, u, v, prim_id, np.int32(mesh), is_entering, _NO_INSTANCE)


@device
def _number(at, k, is_double):
    if is_double:
        return load(np.float64, at + k * _LONG)
    return np.float64(load(np.float32, at + k * BYTES_32))


@device
def direction_at(rays, position):
    """Direction of a ray, scaled so that products with normals are finite."""
    at = rays.directions + position * rays.direction_step
    is_double = rays.directions_are_double
    x = _number(at, _NOWHERE, is_double)
    y = _number(at, ONE_U64, is_double)
    z = _number(at, np.uint64(2), is_double)
    if is_double:
        most = max(abs(x), abs(y), abs(z))
        return x / most, y / most, z / most
    return x, y, z


@device
def _corner(at):
    return (
        np.float64(load(np.float32, at)),
        np.float64(load(np.float32, at + BYTES_32)),
        np.float64(load(np.float32, at + _LONG)),
    )


@device
def faces_front(at, direction):
    """Whether a direction comes from the front of the triangle whose corners are at an address."""
    return is_front(_corner(at), _corner(at + _VECTOR), _corner(at + _VECTOR + _VECTOR), direction)


@device
def is_front(a, b, c, direction):
    """Whether a direction comes from the front of a triangle with these corners, in float64."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a, b, c
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    dx, dy, dz = direction
    along = dx * (by * cz - bz * cy) + dy * (bz * cx - bx * cz) + dz * (bx * cy - by * cx)
    return along < ZERO_F64
