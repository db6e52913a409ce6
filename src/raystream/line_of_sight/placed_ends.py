"""How far segments keep from the planes of triangles in instances.

Rays are tested in the spaces of objects, and round there. So a segment starts where `Hits.spawn`
would start it: off the triangle's plane by the bound in object space, along the normal there. At
its other end it keeps the bound of `end_points`, with lengths in object space.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.spawn import REACH_UNITS, UNIT, WORLD_UNIT, plane_offset, size_of
from raystream.core.store import Store

#: At a segment's far end rounding in the triangle test acts as if each vertex moved by at most
#: about 6 units of its distance from the ray's origin (see `core.spawn`); and the direction is
#: rounded, too, by half a unit of that distance in each coordinate.
FAR_UNITS = 10.0


def unit_of(triangles: Store) -> float:
    """Rounding of the tests of triangles, relative: as in `core.spawn`, or in float64."""
    return UNIT if triangles.number_type is np.float32 else WORLD_UNIT


class PlacedPlanes(NamedTuple):
    """The planes of points on triangles, any shape S, in object space; zeros for misses.

    Attributes
    ----------
    step : ndarray of shape S + (3,), float64
        A local unit of object space along the triangle's normal, in world space.
    height : ndarray of shape S, float64
        Distance of that from the triangle's plane in world space.
    inverse : ndarray of shape S + (3, 3), float64
        World to object space, in local units.
    near, far : ndarray of shape S, float64
        Local units that a segment keeps from the plane where it starts; and where it ends, without
        what grows with its length.
    unit : ndarray of shape S, float64
        Rounding of the tests, relative.
    """

    step: NDArray[np.float64]
    height: NDArray[np.float64]
    inverse: NDArray[np.float64]
    near: NDArray[np.float64]
    far: NDArray[np.float64]
    unit: NDArray[np.float64]

    def at(self, index: Any) -> PlacedPlanes:
        """Pick points by an index into their shape."""
        return PlacedPlanes._make(array[index] for array in self)

    def units_at_end(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Local units that segments keep from the plane where they end.

        Parameters
        ----------
        directions : ndarray of a shape that broadcasts with S + (3,), float64
            From their starts to their ends.
        """
        inverse = self.inverse
        length: Any = 0.0
        x, y, z = np.moveaxis(directions, -1, 0)
        for k in range(3):
            row = inverse[..., k, :]
            length = np.maximum(length, np.abs(row[..., 0] * x + row[..., 1] * y + row[..., 2] * z))
        return self.far + self.unit * (FAR_UNITS + REACH_UNITS) * length


def leaving_heights(
    triangles: InstancedTriangles, numbers: NDArray[np.int64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """World distances from triangles' planes, with these normals, at which rays leave them."""
    prim_id, instance_id = triangles.split_ids(numbers.astype(np.int32))
    corners = triangles.corners_at(prim_id, instance_id)
    corners *= triangles.corner_scales(instance_id)[:, None, None]
    reach = np.abs(corners).max(axis=(1, 2), initial=0.0)
    reaches = triangles.reaches_at(instance_id)
    near = plane_offset(size_of(corners), reach, reaches, unit_of(triangles))
    # A unit along the object's normal is this far from the plane in world space.
    linear = triangles.instances.transforms[instance_id, :, :3]
    height = np.linalg.norm(np.einsum("nij,ni->nj", linear, normals), axis=1)
    heights: NDArray[np.float64] = near * height / triangles.scales_at(instance_id)
    return heights


def placed_planes(hits: Hits, triangles: InstancedTriangles) -> PlacedPlanes:
    """The planes of hits of shape (N,)."""
    count = len(hits.prim_id)
    found = PlacedPlanes(
        np.zeros((count, 3)), np.zeros(count), np.zeros((count, 3, 3)), *np.zeros((3, count))
    )
    rows = np.flatnonzero(hits.is_hit)
    if len(rows) == 0:
        return found
    some, instances = hits[rows], triangles.instances
    ids = some.instance_id
    extents = triangles.local_sizes(some)
    normals = triangles.local_normals(some)
    reach = np.abs(triangles.local_positions(some)).max(axis=-1) * triangles.corner_scales(ids)
    most, world = triangles.reaches_at(ids)
    scale, unit = triangles.scales_at(ids), unit_of(triangles)
    found.step[rows] = np.einsum(
        "nij,nj->ni", instances.transforms[ids, :, :3], normals / scale[:, None]
    )
    found.height[rows] = np.abs(np.einsum("nk,nk->n", found.step[rows], some._world_normals()))
    found.inverse[rows] = instances.inverses[ids, :, :3] * scale[:, None, None]
    found.near[rows] = plane_offset(extents, reach, (most, world), unit)
    # The start is no farther from the object's origin than the end and the length together.
    units = FAR_UNITS * extents + 2.0 * REACH_UNITS * reach
    found.far[rows] = unit * units + WORLD_UNIT * world
    found.unit[rows] = unit
    return found
