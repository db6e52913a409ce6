"""What a program sees of a hit, and where it is read."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.hits import HitArrays
from raystream.kernels.ray_source import RaySource

__all__ = [
    "Hit",
    "RaysAt",
    "RowsAt",
    "SceneAt",
    "close_ray",
    "hit_at",
    "is_open",
    "position_at",
    "ray_at",
    "row_range",
]

_NOWHERE = np.uint64(0)
_ENDED = np.uint8(0)
_ONE = np.uint64(1)
_WORD = np.uint64(4)
_LONG = np.uint64(8)
_VECTOR = np.uint64(12)
_TRIANGLE = np.uint64(36)
_ZERO = np.float64(0.0)


class Hit(NamedTuple):
    """A hit, as a program sees it. What a program does not use is not computed.

    Attributes
    ----------
    ray : int64
        Index of the ray in the flattened batch.
    t, u, v : float32
        Distance in direction lengths, and the weights of vertices 1 and 2.
    prim_id, mesh_id : int32
        Triangle, counted over the whole scene, and its mesh.
    is_entering : bool
        Whether the ray comes from the side to which the triangle's normal points, where its
        vertices run counter-clockwise: whether it enters a closed mesh here.
    """

    ray: int
    t: float
    u: float
    v: float
    prim_id: int
    mesh_id: int
    is_entering: bool


class RowsAt(NamedTuple):
    """Where the rows of a query's answer lie; the caller keeps them.

    Attributes
    ----------
    t, u, v, prim_id : uint64
        Addresses of the first row's numbers.
    splits : uint64
        Address of the entries' first rows, int64; 0 if row i is entry i's, or a miss.
    counts : uint64
        Address of how many rows of its own each entry has, int64; 0 if those up to the next
        entry's.
    delivered : uint64
        Rows of each ray that a program has seen before.
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
        """Where these rows lie; without `splits` there is one for each ray."""
        places = (*map(_place, hits), _place(splits), 0, delivered)
        return cls(*np.array(places, np.uint64))

    @classmethod
    def nowhere(cls) -> RowsAt:
        """No rows."""
        return cls(*np.zeros(7, np.uint64))


class SceneAt(NamedTuple):
    """Where triangles lie; the caller keeps them.

    Attributes
    ----------
    corners, mesh_splits : uint64
        Addresses of `Triangles.corners` and `Triangles.mesh_splits`.
    mesh_count : uint64
    halvings : uint64
        Steps of a search among the meshes.
    """

    corners: np.uint64
    mesh_splits: np.uint64
    mesh_count: np.uint64
    halvings: np.uint64

    @classmethod
    def of(cls, triangles: Triangles) -> SceneAt:
        """Where these triangles lie."""
        count = len(triangles.mesh_splits) - 1
        places = triangles.corners.ctypes.data, triangles.mesh_splits.ctypes.data
        return cls(*np.array((*places, count, max(count - 1, 0).bit_length()), np.uint64))


class RaysAt(NamedTuple):
    """Whose rows the entries of a part are, and where the rays' directions lie.

    Attributes
    ----------
    positions : uint64
        Address of the entries' positions among the rays traced; 0 if they follow each
        other.
    positions_are_short : bool
        Whether they are int32, else int64.
    start : uint64
        Position of the first one if they follow each other.
    ids : uint64
        Address of the indices in the batch of the rays traced, int64; 0 if they follow
        each other.
    first : uint64
        Index of the first one if they follow each other.
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
        """Where the rays of a source lie."""
        places = _place(positions), start, _place(ids), first
        position_place, start_place, id_place, first_place = np.array(places, np.uint64)
        return cls(
            position_place,
            positions is not None and positions.itemsize == 4,
            start_place,
            id_place,
            first_place,
            source.directions,
            source.direction_step,
            source.directions_are_double,
        )

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
        return np.uint64(load(np.int32, rays.positions + i * _WORD))
    return np.uint64(load(np.int64, rays.positions + i * _LONG))


@device
def ray_at(rays, position):
    """Index in the batch of a ray that was traced."""
    if rays.ids == _NOWHERE:
        return rays.first + position
    return np.uint64(load(np.int64, rays.ids + position * _LONG))


@device
def is_open(open_rays, position):
    """Whether no program has ended a ray: its byte at an address."""
    return load(np.uint8, open_rays + position) != _ENDED


@device
def close_ray(open_rays, position):
    """Say that a ray has ended."""
    store(open_rays + position, _ENDED)


@device
def row_range(rows, i):
    """The rows of entry i that are new, as first and end."""
    if rows.splits == _NOWHERE:
        if load(np.int32, rows.prim_id + i * _WORD) < 0:
            return i, i
        return i, i + _ONE
    at = rows.splits + i * _LONG
    first, end = np.uint64(load(np.int64, at)), np.uint64(load(np.int64, at + _LONG))
    if rows.counts != _NOWHERE:
        end = first + np.uint64(load(np.int64, rows.counts + i * _LONG))
    return min(first + rows.delivered, end), end


@device
def hit_at(rows, row, rays, position, ray, scene):
    """The hit of a row of the ray at a position, whose index in the batch is `ray`."""
    at = row * _WORD
    prim_id = load(np.int32, rows.prim_id + at)
    return Hit(
        np.int64(ray),
        load(np.float32, rows.t + at),
        load(np.float32, rows.u + at),
        load(np.float32, rows.v + at),
        prim_id,
        _mesh_of(scene, prim_id),
        _is_entering(scene, prim_id, rays, position),
    )


@device
def _mesh_of(scene, prim_id):
    """Binary search of a fixed number of steps, which goes away where it is not used."""
    low, high = _NOWHERE, scene.mesh_count
    for _ in range(scene.halvings):
        middle = (low + high) >> _ONE
        is_above = load(np.int64, scene.mesh_splits + middle * _LONG) <= np.int64(prim_id)
        low = middle if is_above else low
        high = high if is_above else middle
    return np.int32(low)


@device
def _number(at, k, is_double):
    if is_double:
        return load(np.float64, at + k * _LONG)
    return np.float64(load(np.float32, at + k * _WORD))


@device
def _direction(rays, position):
    """Direction of a ray, of a length at which products with normals are finite."""
    at = rays.directions + position * rays.direction_step
    is_double = rays.directions_are_double
    x = _number(at, _NOWHERE, is_double)
    y = _number(at, _ONE, is_double)
    z = _number(at, np.uint64(2), is_double)
    if is_double:
        most = max(abs(x), abs(y), abs(z))
        return x / most, y / most, z / most
    return x, y, z


@device
def _corner(at):
    return (
        np.float64(load(np.float32, at)),
        np.float64(load(np.float32, at + _WORD)),
        np.float64(load(np.float32, at + _LONG)),
    )


@device
def _is_entering(scene, prim_id, rays, position):
    at = scene.corners + np.uint64(prim_id) * _TRIANGLE
    ax, ay, az = _corner(at)
    bx, by, bz = _corner(at + _VECTOR)
    cx, cy, cz = _corner(at + _VECTOR + _VECTOR)
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    dx, dy, dz = _direction(rays, position)
    along = dx * (by * cz - bz * cy) + dy * (bz * cx - bx * cz) + dz * (bx * cy - by * cx)
    return along < _ZERO
