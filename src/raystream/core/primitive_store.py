"""PrimitiveStore: ids of scenes with height fields, spheres and shapes, in instances or not."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.shapes import Shapes
from raystream.core.spheres import Spheres, directions_at
from raystream.core.store import Store

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns

#: Rays leave a sphere from this part of (its radius + its centre's largest coordinate) beside its
#: surface: 16 times the rounding of the origin to float64, and of the test.
LEAVING = 2.0**-48


class PrimitiveStore(Store):
    """Where ``prim_id`` counts triangles of meshes, those of height fields, spheres, then shapes.

    Attributes
    ----------
    fields : tuple of HeightField
    spheres : Spheres
    shapes : tuple of Shapes
    first_fields : ndarray of shape (K + 1,), int64
        Field k owns the prim_ids in [first_fields[k], first_fields[k + 1]); the last number is the
        first sphere's.
    """

    spheres: Spheres
    shapes: tuple[Shapes, ...] = ()
    first_fields: NDArray[np.int64]

    def sphere_rows(self, prim_id: NDArray[np.int32]) -> NDArray[np.int64]:
        """The spheres of hits, -1 for other primitives and misses."""
        first = int(self.first_fields[-1])
        is_sphere = (prim_id >= first) & (prim_id < first + len(self.spheres))
        return np.where(is_sphere, prim_id.astype(np.int64) - first, -1)

    def _on_spheres(
        self, hits: HitColumns
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.float64]]:
        """Which hits are of spheres; of these the spheres, and unit vectors from their centres."""
        rows = self.sphere_rows(hits.prim_id)
        is_sphere = rows >= 0
        return is_sphere, rows[is_sphere], directions_at(hits.u[is_sphere], hits.v[is_sphere])

    def beside(
        self,
        rows: NDArray[np.int64],
        normals: NDArray[np.float64],
        directions: NDArray[Any],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Points beside spheres, shape (N, 3), on the sides that directions point to.

        `normals` are those of the spheres themselves, also in instances; the rest is in world
        space.
        """
        return self._beside(rows, normals, directions, 0.0)

    def _beside(
        self,
        rows: NDArray[np.int64],
        normals: NDArray[np.float64],
        directions: NDArray[Any],
        far: Any,
    ) -> NDArray[np.float64]:
        """The same among the spheres; `far`: what else rays' origins are rounded at."""
        centers, radii = self.spheres.centers[rows], self.spheres.radii[rows]
        side = np.einsum("ij,ij->i", normals, directions)
        side = np.where(side >= 0.0, 1.0, -1.0)
        offset = LEAVING * (radii + np.abs(centers).max(axis=1, initial=0.0) + far)
        beside: NDArray[np.float64] = centers + (radii + side * offset)[:, None] * normals
        return beside

    def is_curved(self, prim_id: NDArray[np.int32]) -> NDArray[np.bool_]:
        """See `Store.is_curved`."""
        return prim_id >= self.first_fields[-1]

    def shape_rows(
        self, prim_id: NDArray[np.int32]
    ) -> Iterator[tuple[Shapes, NDArray[np.int64], NDArray[np.int64]]]:
        """Of each of `shapes`: those of some hits, of shape (N,), and which ones they are."""
        for own, first in zip(self.shapes, self._first_shapes(), strict=False):
            rows = np.flatnonzero((prim_id >= first) & (prim_id < first + len(own)))
            if len(rows):
                yield own, rows, prim_id[rows].astype(np.int64) - first

    def _first_shapes(self) -> list[int]:
        """The prim_id of the first one of each of `shapes`, and of what would be next."""
        first = int(self.first_fields[-1]) + len(self.spheres)
        return list(accumulate(map(len, self.shapes), initial=first))

    def materials_at(self, prim_id: NDArray[np.int32]) -> NDArray[np.int32]:
        """Materials of hits, int32; -1 for misses."""
        materials = super().materials_at(prim_id)
        firsts = self.first_fields
        for k, field in enumerate(self.fields):
            is_here = (prim_id >= firsts[k]) & (prim_id < firsts[k + 1])
            materials[is_here] = field.material_id
        spheres = self.sphere_rows(prim_id)
        materials[spheres >= 0] = self.spheres.material_ids[spheres[spheres >= 0]]
        flat = materials.reshape(-1)
        for shapes, rows, own in self.shape_rows(prim_id.reshape(-1)):
            flat[rows] = shapes.material_ids[own]
        return flat.reshape(materials.shape)
