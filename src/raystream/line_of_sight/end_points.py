"""The ends of segments: free points, and points on surfaces, which segments leave without a hit.

A segment between free points includes its ends. A point on a surface moves off its triangle's
plane, to the side of the other end, by a bound of the rounding errors: that of `core.spawn` where
rays start, and one for the far end, which also grows with the length of the segment.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.core.rays import as_integers, as_real_array
from raystream.core.scene_kinds import check_support
from raystream.core.spawn import EXTENT_UNITS, MOST_UNITS, REACH_UNITS, WORLD_UNIT
from raystream.core.store import Store
from raystream.core.triangles import MAX_COORDINATE
from raystream.line_of_sight.placed_ends import FAR_UNITS, PlacedPlanes, placed_planes, unit_of
from raystream.programs.filters import Bound
from raystream.tracer import Tracer

#: Other ends within this many of its own distances of a point's plane are in that plane.
IN_PLANE = 2.0


class EndPoints(NamedTuple):
    """Points of any shape S as ends of segments.

    Attributes
    ----------
    positions : ndarray of shape S + (3,), float64
        World space; zeros for invalid points.
    is_valid : ndarray of shape S, bool
        Whether a point is finite, and not a miss or on a degenerate triangle.
    reach : ndarray of shape S, float64
        Largest absolute coordinate, local frame.
    normals : ndarray of shape S + (3,), float64, or None
        Of points on surfaces: unit normals of their triangles.
    extents : ndarray of shape S, float64, or None
        Of points on surfaces: sizes of their triangles, local frame; zeros with instances.
    skipped : ndarray of shape S + (k,), int64, or None
        Triangles that hide nothing from the point; -1 for none.
    planes : PlacedPlanes or None
        Of points on surfaces of instances.
    """

    positions: NDArray[np.float64]
    is_valid: NDArray[np.bool_]
    reach: NDArray[np.float64]
    normals: NDArray[np.float64] | None
    extents: NDArray[np.float64] | None
    skipped: NDArray[np.int64] | None
    planes: PlacedPlanes | None = None

    def at(self, index: Any) -> EndPoints:
        """Pick points by an index into their shape."""
        picked: list[Any] = [None if array is None else array[index] for array in self.arrays]
        planes = None if self.planes is None else self.planes.at(index)
        return EndPoints._make([*picked, planes])

    @property
    def arrays(self) -> tuple[NDArray[Any] | None, ...]:
        """The arrays that describe the points; those of planes follow from the scene."""
        return self[:-1]


def check_tracer(tracer: Any) -> None:
    """Raise TypeError if it is not a tracer."""
    if not isinstance(tracer, Tracer):
        raise TypeError(
            f"tracer: expected a Tracer, got {type(tracer).__name__}; make one with "
            "rs.Tracer(scene)"
        )


def planes_of(
    corners: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals (NaN without an area), extents and areas of triangles.

    Parameters
    ----------
    corners : ndarray of shape S + (3, 3), float64
    """
    first = corners[..., 0, :]
    normals = np.cross(corners[..., 1, :] - first, corners[..., 2, :] - first)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # Scaled before it is measured: the square of a small area would vanish.
        largest = np.abs(normals).max(axis=-1, keepdims=True)
        normals = normals / largest
        lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
        normals /= lengths
        areas = 0.5 * (largest * lengths)[..., 0]
    extents = (corners.max(axis=-2) - corners.min(axis=-2)).max(axis=-1)
    return normals, extents, np.where(np.isfinite(areas), areas, 0.0)


def leaving_distance(
    triangles: Store,
    extents: NDArray[np.float64],
    reach: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Distances from triangles' planes, local frame, at which rays that leave them start.

    Those of `core.spawn.plane_offset`.
    """
    units = EXTENT_UNITS * extents + REACH_UNITS * reach
    most = MOST_UNITS * (float(triangles.max_coordinate) + reach)
    return unit_of(triangles) * np.minimum(units, most) + _world_rounding(triangles)


def _world_rounding(triangles: Store) -> float:
    return WORLD_UNIT * float(np.abs(triangles.center).max()) * triangles.scale


def end_points(name: str, values: Any, skipped: Any, triangles: Any) -> EndPoints:
    """Read points: an array of shape (N, 3), or hits of any shape, flattened.

    Parameters
    ----------
    name : str
        Name of the argument, for errors; `skipped` is ``skip_`` and the name.
    values : array_like of shape (N, 3), real, or Hits
    skipped : array_like of shape (N,) or (N, k), int, or None
    triangles : Store
        The traced ones.

    Raises
    ------
    ValueError
        If a shape does not fit, the hits are of another scene, or a triangle does not exist.
    TypeError
        If numbers are not real, or triangles not integers.
    """
    normals = extents = planes = None
    if isinstance(values, Hits):
        hits = values.ravel()
        own: Any = hits._triangles
        check_support("points on surfaces", own)
        is_same = own.scale == triangles.scale and np.array_equal(own.center, triangles.center)
        if not (is_same and type(own) is type(triangles)):
            raise ValueError(f"{name}: the hits are of another scene than the tracer's")
        positions, is_valid = hits.positions, hits.is_hit.copy()
        if own.instances is not None:
            normals, extents = hits._world_normals(), np.zeros(len(positions))
            planes = placed_planes(hits, own)
        else:
            normals, extents = own.planes_at(hits)
        is_valid &= np.isfinite(normals).all(axis=-1)
        normals[~is_valid] = extents[~is_valid] = 0.0
    else:
        positions = as_real_array(name, values).astype(np.float64)
        if positions.size == 0 and positions.ndim == 1:
            positions = positions.reshape(0, 3)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise ValueError(f"{name}: expected shape (N, 3) or Hits, got {positions.shape}")
        is_valid = np.ones(len(positions), bool)
    with np.errstate(invalid="ignore"):
        is_valid &= (np.abs(positions) <= MAX_COORDINATE).all(axis=-1)
    positions[~is_valid] = 0.0
    reach = np.abs((positions - triangles.center) * triangles.scale).max(axis=-1, initial=0.0)
    ids = None if skipped is None else _skipped(f"skip_{name}", skipped, len(positions), triangles)
    return EndPoints(positions, is_valid, reach, normals, extents, ids, planes)


def _skipped(name: str, values: Any, count: int, triangles: Any) -> NDArray[np.int64]:
    ids = as_integers(name, values)
    if ids.ndim not in (1, 2) or len(ids) != count:
        raise ValueError(f"{name}: expected shape ({count},) or ({count}, k), got {ids.shape}")
    if ids.size and not (ids.min() >= -1 and ids.max() < len(triangles)):
        raise ValueError(f"{name}: expected triangles, 0 to {len(triangles) - 1:,}, or -1")
    return ids.reshape(count, -1).astype(np.int64)


def is_clear(
    tracer: Tracer,
    starts: EndPoints,
    stops: EndPoints,
    front_only: bool,
    on_hit: Bound | None = None,
) -> NDArray[np.bool_]:
    """Whether nothing is between points.

    Parameters
    ----------
    tracer : Tracer
    starts, stops : EndPoints
        Of shapes that broadcast to a shape S; segments run from the first to the second.
    front_only : bool
        Whether points on surfaces see only what is in front of their triangle.
    on_hit : Bound, optional
        The filter of what may hide a point.

    Returns
    -------
    ndarray of shape S, bool
    """
    frame = tracer.structure.triangles
    delta = stops.positions - starts.positions
    shape = delta.shape[:-1]
    length = _largest(delta)
    is_same = length == 0.0
    clear = np.broadcast_to(starts.is_valid & stops.is_valid, shape).copy()
    # Only the end of a long segment is traced: further from the stop there is no scene, and t is
    # rounded in proportion to its length.
    length *= frame.scale
    longest = 2.0 * (stops.reach + float(frame.max_coordinate))
    origins: NDArray[np.float64] = np.broadcast_to(starts.positions, delta.shape)
    directions = delta
    if (length > longest).any():
        with np.errstate(divide="ignore", invalid="ignore"):
            directions = delta * np.fmin(longest / length, 1.0)[..., None]
        is_cut = (length > longest)[..., None]
        origins = np.where(is_cut, stops.positions - directions, origins)
        length = np.minimum(length, longest)
    if starts.normals is not None or stops.normals is not None:
        if starts.normals is not None and starts.extents is not None:
            if starts.planes is None:
                distance = leaving_distance(frame, starts.extents, starts.reach) / frame.scale
                side = _side(starts.normals, delta, distance, front_only, clear)
                offset = (side * distance)[..., None] * starts.normals
            else:
                near = starts.planes.near
                height = near * starts.planes.height
                side = _side(starts.normals, delta, height, front_only, clear)
                offset = (side * near)[..., None] * starts.planes.step
            origins, directions = origins + offset, directions - offset
        if stops.normals is not None and stops.extents is not None:
            if stops.planes is None:
                units = FAR_UNITS * (length + stops.extents)
                nearer = np.minimum(starts.reach, stops.reach + length)
                units += REACH_UNITS * (nearer + stops.reach)
                distance = (unit_of(frame) * units + _world_rounding(frame)) / frame.scale
                side = _side(stops.normals, -delta, distance, front_only, clear)
                directions = directions + (side * distance)[..., None] * stops.normals
            else:
                units = stops.planes.units_at_end(directions)
                height = units * stops.planes.height
                side = _side(stops.normals, -delta, height, front_only, clear)
                directions = directions + (side * units)[..., None] * stops.planes.step
    if not clear.any():
        return clear
    skipped = None
    if starts.skipped is not None or stops.skipped is not None:
        lists = [ends.skipped for ends in (starts, stops) if ends.skipped is not None]
        wide = [np.broadcast_to(ids, (*shape, ids.shape[-1])) for ids in lists]
        skipped = np.concatenate(wide, axis=-1).reshape(-1, sum(ids.shape[-1] for ids in lists))
    rays = origins.reshape(-1, 3), directions.reshape(-1, 3)
    blocked = tracer.any_hit(*rays, t_max=1.0, on_hit=on_hit, skip_prim_ids=skipped)
    blocked = blocked.reshape(shape)
    clear &= is_same | ~blocked
    return clear


def _largest(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Largest absolute component; NumPy is ten times slower along an axis of three."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.maximum(np.maximum(np.abs(x), np.abs(y)), np.abs(z))


def _side(
    normals: NDArray[np.float64],
    toward: NDArray[np.float64],
    distance: NDArray[np.float64],
    front_only: bool,
    clear: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """The sides to which segments leave: 1 to the front, also in the plane itself, else -1.

    With `front_only`, `clear` becomes false where the other end is not in front.
    """
    height = np.einsum("...k,...k->...", np.broadcast_to(normals, toward.shape), toward)
    if front_only:
        clear &= height > IN_PLANE * distance
    return np.where(height >= -IN_PLANE * distance, 1.0, -1.0)
