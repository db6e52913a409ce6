"""PlacedHits: the geometry of hits of instances, each in the frame of its object."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.float64_triangles import float64_offset
from raystream.core.instances import Instances, moved
from raystream.core.primitive_store import PrimitiveStore
from raystream.core.spawn import WORLD_UNIT, side_of

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns


class _ObjectHits(NamedTuple):
    """Hits of an object, as methods of its store take them."""

    prim_id: NDArray[np.int32]
    u: NDArray[Any]
    v: NDArray[Any]
    instance_id: NDArray[np.int32]


class PlacedHits(PrimitiveStore):
    """What hits of instances have of their objects: a base of `InstancedTriangles`.

    Attributes
    ----------
    objects : tuple of Store
    instances : Instances
    parts : ndarray of shape (O, 3, 2), int64
        Of the triangles of each object's meshes, those of its height fields, and its spheres: the
        first one's number in the object, and its prim_id.
    """

    objects: tuple[Any, ...]
    instances: Instances
    parts: NDArray[np.int64]

    def parts_of(self, prim_id: NDArray[Any]) -> NDArray[np.int64]:
        """0 for the triangles of meshes, 1 for those of height fields, 2 for spheres."""
        is_beside = (prim_id >= self.first_fields[0]).astype(np.int64)
        return is_beside + (prim_id >= self.first_fields[-1])

    def _within(self, k: int, prim_id: NDArray[Any]) -> NDArray[np.int32]:
        """The prim_ids in object k of those in the scene."""
        places = self.parts[k, self.parts_of(prim_id)]
        return (prim_id - places[:, 1] + places[:, 0]).astype(np.int32)

    def prims_of(self, k: int, own: NDArray[np.int32]) -> NDArray[np.int32]:
        """The prim_ids in the scene of those in object k."""
        part = (own >= self.parts[k, 1, 0]).astype(np.int64) + (own >= self.parts[k, 2, 0])
        places = self.parts[k, part]
        return (own - places[:, 0] + places[:, 1]).astype(np.int32)

    def corners_at(
        self, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Corners of triangles in their objects' local frames; see `Store.corners_at`."""
        prims = prim_id.reshape(-1)
        corners = np.full((len(prims), 3, 3), np.nan)
        for k, rows in self._by_object(instance_id):
            own = self._within(k, prims[rows])
            corners[rows] = self.objects[k].corners_at(own, np.zeros_like(own))
        return corners.reshape(*prim_id.shape, 3, 3)

    def local_corners(self, numbers: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """See `Store.local_corners`."""
        ids: Any = self.ids_of(numbers.astype(np.int32))
        corners = self.points_to_world(self.corners_at(*ids), ids[1])
        return (corners - self.center) * self.scale

    def touching_corners(self, hits: HitColumns) -> NDArray[np.float64]:
        """See `Store.touching_corners`."""
        corners = self._of_objects(hits, lambda one, held: one.touching_corners(held), 3, 3)
        is_hit = hits.prim_id >= 0
        matrices = self.instances.transforms[hits.instance_id[is_hit]]
        turned = np.einsum("nij,nkj->nki", matrices[:, :, :3], corners[is_hit])
        corners[is_hit] = turned + matrices[:, None, :, 3]
        corners[~is_hit] = 0.0
        return corners

    def _of_objects(
        self, hits: HitColumns, measure: Callable[[Any, Any], NDArray[Any]], *tail: int
    ) -> NDArray[np.float64]:
        """``measure(object, its hits)`` of all hits; NaN for misses."""
        columns = [one.reshape(-1) for one in (hits.prim_id, hits.u, hits.v)]
        found = np.full((len(columns[0]), *tail), np.nan)
        for k, rows in self._by_object(hits.instance_id):
            prims, u, v = (one[rows] for one in columns)
            own = self._within(k, prims)
            part = _ObjectHits(own, u, v, np.zeros_like(own))
            found[rows] = measure(self.objects[k], part)
        return found.reshape(*hits.prim_id.shape, *tail)

    def planes_at(self, hits: HitColumns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Store.planes_at`."""
        normals = self.normals_to_world(self.local_normals(hits), hits.instance_id)
        return normals, self.local_sizes(hits)

    def local_sizes(self, hits: HitColumns) -> NDArray[np.float64]:
        """Sizes of what is hit in their objects' local frames; see `Store.planes_at`."""
        return self._of_objects(hits, lambda one, held: one.planes_at(held)[1])

    def local_positions(self, hits: HitColumns) -> NDArray[np.float64]:
        """Points of hits in their objects' local frames; see `Store`."""
        return self._of_objects(hits, lambda one, held: one.local_positions(held), 3)

    def local_normals(self, hits: HitColumns) -> NDArray[np.float64]:
        """Unit normals of hits in object space; see `Store`."""
        return self._of_objects(hits, lambda one, held: one.local_normals(held), 3)

    def flat_corners(self, hits: HitColumns) -> NDArray[np.float32]:
        """See `Primitives.flat_corners`; in mirrored instances the same side is the front."""
        ids = hits.instance_id
        inside = self._of_objects(hits, lambda one, held: one.flat_corners(held), 3, 3)
        corners = (self.points_to_world(inside, ids) - self.center) * self.scale
        turned = self.are_mirrored(ids)
        corners[turned] = corners[turned][:, [0, 2, 1]]
        corners[hits.prim_id < 0] = 0.0
        return corners.astype(np.float32)

    def are_mirrored(self, instance_id: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Whether instances mirror their objects."""
        linear = self.instances.transforms[:, :, :3]
        largest = np.abs(linear).max(axis=(1, 2), keepdims=True)
        return np.asarray(np.linalg.det(linear / largest) < 0.0)[instance_id]

    def spawned(self, hits: HitColumns, directions: NDArray[Any]) -> NDArray[np.float64]:
        """Origins of rays that leave hits, world space; see `Hits.spawn`."""
        if self.number_type is np.float64:
            return self._spawned_in_float64(hits, directions)
        origins = super().spawned(hits, directions)
        is_sphere, rows, normals = self._on_spheres(hits)
        ids = hits.instance_id[is_sphere]
        origins[is_sphere] = self.beside(rows, normals, directions[is_sphere], ids)
        return origins

    def beside(
        self,
        rows: NDArray[np.int64],
        normals: NDArray[np.float64],
        directions: NDArray[Any],
        instance_id: NDArray[np.int32],
    ) -> NDArray[np.float64]:
        """See `PrimitiveStore.beside`."""
        far = self.reaches_at(instance_id)[1] / self.scales_at(instance_id)
        own = self.directions_to_local(directions, instance_id)
        return moved(self.instances.transforms[instance_id], self._beside(rows, normals, own, far))

    def scales_at(self, instance_id: NDArray[np.int32]) -> NDArray[np.float64]:
        """Local units of instances' objects per unit of their spaces."""
        scales = np.array([float(one.scale) for one in self.objects])
        return scales[self.instances.object_ids[instance_id]]

    def corner_scales(self, instance_id: NDArray[np.int32]) -> NDArray[np.float64]:
        """The same per unit of `corners_at` and `local_positions`: in float64 not local ones."""
        scales = self.scales_at(instance_id)
        return scales if self.number_type is np.float64 else np.ones_like(scales)

    def points_to_world(
        self, points: NDArray[np.float64], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Move points from objects' local frames to world space.

        Parameters
        ----------
        points : ndarray of shape S + (3,) or S + (k, 3), float64
        instance_id : ndarray of shape S, int32
        """
        ids = instance_id.reshape(-1)
        local = points.reshape(len(ids), points.size // max(1, 3 * len(ids)), 3)
        world = np.full(local.shape, np.nan)
        for k, rows in self._by_object(instance_id):
            matrices = self.instances.transforms[ids[rows]]
            inside = self.objects[k].points_to_world(local[rows], ids[rows])
            moved = np.einsum("kij,knj->kni", matrices[:, :, :3], inside)
            world[rows] = moved + matrices[:, None, :, 3]
        return world.reshape(points.shape)

    def normals_to_world(
        self, normals: NDArray[np.float64], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Unit normals of shape (..., 3) in world space, on the same side of the surface."""
        world = np.full(normals.shape, np.nan)
        is_hit = instance_id >= 0
        inverses = self.instances.inverses[instance_id[is_hit]][:, :, :3]
        with np.errstate(invalid="ignore", divide="ignore"):
            # Scaled before they are multiplied and measured: small numbers would vanish.
            inverses = inverses / np.abs(inverses).max(axis=(1, 2), keepdims=True, initial=0.0)
            moved = _product(inverses.swapaxes(1, 2), normals[is_hit])
            moved /= np.abs(moved).max(axis=-1, keepdims=True, initial=0.0)
            world[is_hit] = moved / np.linalg.norm(moved, axis=-1, keepdims=True)
        return world

    def directions_to_local(
        self, directions: NDArray[Any], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """World directions of shape (..., 3) in the spaces of the hits' objects."""
        moved = np.full(directions.shape, np.nan)
        is_hit = instance_id >= 0
        inverses = self.instances.inverses[instance_id[is_hit]][:, :, :3]
        moved[is_hit] = _product(inverses, directions[is_hit].astype(np.float64))
        return moved

    def reaches_at(
        self, instance_id: NDArray[np.int32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Largest coordinates of the hits' objects; see `Store.reaches_at`.

        The second is the length of the terms of ``inverse @ world``, each of which rounds.
        """
        ids = instance_id.reshape(-1)
        extent, far = np.zeros((2, len(ids)))
        for k, rows in self._by_object(instance_id):
            one = self.objects[k]
            matrices = np.abs(self.instances.transforms[ids[rows]])
            inverses = np.abs(self.instances.inverses[ids[rows]])
            inside = np.full((len(rows), 3), np.abs(one.world_bounds).max())
            terms = moved(inverses, moved(matrices, inside))
            extent[rows] = float(one.max_coordinate)
            far[rows] = (terms.max(axis=1) + np.abs(one.center).max()) * one.scale
        return extent.reshape(instance_id.shape), far.reshape(instance_id.shape)

    def _spawned_in_float64(
        self, hits: HitColumns, directions: NDArray[Any]
    ) -> NDArray[np.float64]:
        """See `Float64Triangles.spawned`; and the rounding of a move to object space and back."""
        ids = hits.instance_id
        positions, normals = self.local_positions(hits), self.local_normals(hits)
        corners = self.corners_at(hits.prim_id, ids)
        far = WORLD_UNIT * self.reaches_at(ids)[1] / self.scales_at(ids)
        offset = float64_offset(corners) + far
        side = side_of(normals, self.directions_to_local(directions, ids))
        return self.points_to_world(positions + (side * offset)[..., None] * normals, ids)

    def world_lengths(
        self, lengths: NDArray[np.float64], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """See `Store.world_lengths`."""
        longest = np.linalg.norm(self.instances.transforms[instance_id, :, :3], axis=(-2, -1))
        return longest * lengths / self.scales_at(instance_id)

    def _by_object(self, instance_id: NDArray[np.int32]) -> list[tuple[int, NDArray[np.int64]]]:
        """The objects that are hit, and the rows of the hits of each, in the flattened array."""
        ids = instance_id.reshape(-1)
        rows = np.flatnonzero(ids >= 0)
        objects = self.instances.object_ids[ids[rows]]
        order = np.argsort(objects, kind="stable")
        rows, objects = rows[order], objects[order]
        firsts = np.flatnonzero(np.diff(objects, prepend=-1))
        parts = np.split(rows, firsts[1:]) if len(rows) else []
        return [(int(objects[first]), part) for first, part in zip(firsts, parts, strict=True)]


def _product(matrices: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products of matrices of shape (N, 3, 3) and vectors of shape (N, 3)."""
    return np.einsum("kij,kj->ki", matrices, vectors)
