"""PrimitiveHits and PrimitiveMultiHits: hits of triangles, height fields and spheres."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import HitColumns, Hits, MultiHits

#: Rays leave a sphere from this part of (its radius + its centre's largest coordinate) beside its
#: surface: 16 times the rounding of the origin to float64, and of the test.
LEAVING = 2.0**-48


class PrimitiveColumns(HitColumns):
    """Columns of hits, of which some are of spheres.

    For a sphere, u and v are where on it the hit is, see `core.spheres.directions_at`, and normals
    point away from the centre.
    """

    _triangles: Any

    @cached_property
    def material_id(self) -> NDArray[np.int32]:
        """Material in `Scene.materials`, int32, of the hits' shape; a miss has -1."""
        return self._triangles.materials_at(self.prim_id)

    @property
    def is_on_sphere(self) -> NDArray[np.bool_]:
        """Whether each hit is one of a sphere, bool, of the hits' shape."""
        return self._triangles.sphere_rows(self.prim_id) >= 0

    def _sphere_directions(self) -> NDArray[np.float64]:
        return self._triangles.sphere_directions(self.prim_id, self.u, self.v)

    def _local_positions(self) -> NDArray[np.float64]:
        positions = super()._local_positions()
        held = self._triangles
        rows = held.sphere_rows(self.prim_id)
        is_sphere = rows >= 0
        spheres = rows[is_sphere]
        centers = held.spheres.centers[spheres] - held.center
        away = held.spheres.radii[spheres, None] * self._sphere_directions()[is_sphere]
        positions[is_sphere] = (centers + away) * held.scale
        return positions

    def _local_normals(self) -> NDArray[np.float64]:
        normals = super()._local_normals()
        is_sphere = self.is_on_sphere
        normals[is_sphere] = self._sphere_directions()[is_sphere]
        return normals

    def _interpolated(self, table: NDArray[np.float32] | None, width: int) -> NDArray[np.float64]:
        """As of triangles; NaN for other primitives."""
        values = np.full((*self.prim_id.shape, width), np.nan)
        is_triangle = (self.prim_id >= 0) & (self.prim_id < self._triangles.first_fields[0])
        columns = (self.t, self.u, self.v, self.prim_id)
        t, u, v, prim_id = (one[is_triangle] for one in columns)
        status = np.zeros(len(t), np.uint8)
        some = Hits(t, u, v, prim_id, status, self._triangles)
        values[is_triangle] = HitColumns._interpolated(some, table, width)
        return values

    def flat_corners(self) -> NDArray[np.float32]:
        """Corners of flat surfaces, shape (N, 3, 3), float32, local frame; 0 for misses.

        The triangles that are hit; for spheres, triangles in the plane that touches them at the
        hit, which is the first corner. Hits must have shape (N,).
        """
        corners = self._corners()
        is_sphere = self.is_on_sphere
        normals = self._sphere_directions()[is_sphere]
        first = self._local_positions()[is_sphere]
        # As large as the coordinates: rounding then turns the plane by some 2**-22.
        size = 0.25 * np.abs(first).max(axis=1, initial=0.0)
        size = np.where(size > 0.0, size, 1.0)[:, None]
        axis = np.eye(3)[np.abs(normals).argmin(axis=1)] if len(normals) else np.zeros((0, 3))
        across = np.cross(axis, normals)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        second, third = first + size * across, first + size * np.cross(normals, across)
        corners[is_sphere] = np.stack([first, second, third], axis=1)
        corners[self.prim_id < 0] = 0.0
        return corners.astype(np.float32)

    def spawn(self, directions: Any) -> tuple[NDArray[np.float64], NDArray[Any]]:
        """Make rays that leave the surfaces hit; see `HitColumns.spawn`.

        A ray into a sphere does not meet the point that it leaves, but the sphere's other side.
        """
        origins, given = super().spawn(directions)
        held = self._triangles
        rows = held.sphere_rows(self.prim_id)
        is_sphere = rows >= 0
        spheres = rows[is_sphere]
        normals = self._sphere_directions()[is_sphere]
        centers, radii = held.spheres.centers[spheres], held.spheres.radii[spheres]
        side = np.einsum("ij,ij->i", normals, given[is_sphere])
        side = np.where(side >= 0.0, 1.0, -1.0)
        offset = LEAVING * (radii + np.abs(centers).max(axis=1, initial=0.0))
        origins[is_sphere] = centers + (radii + side * offset)[:, None] * normals
        return origins, given


class PrimitiveHits(PrimitiveColumns, Hits):
    """`Hits` in a scene with spheres or height fields."""


class PrimitiveMultiHits(PrimitiveColumns, MultiHits):
    """`MultiHits` in a scene with spheres or height fields."""
