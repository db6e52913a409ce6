"""Crossings of meshes in instances: each mesh of each instance is a solid of its own."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.triangles import Triangles
from raystream.geometry.instances.records import (
    InstanceRecord,
    ObjectRecord,
    instance_records,
    object_records,
)
from raystream.geometry.instances.structure import InstancedStructure
from raystream.jit.cpu import kernel
from raystream.kernels.ray import prepare_ray
from raystream.kernels.ray_source import load_ray
from raystream.kernels.solids import Solids, solids_of
from raystream.physics.hit_crossings import solids_with
from raystream.physics.pairing import classify_crossing


class _RecordsAt(NamedTuple):
    """Addresses of the first `InstanceRecord` and the first `ObjectRecord`."""

    instances: np.uint64
    objects: np.uint64


class PlacedSolids:
    """The meshes of all instances, as solids that are numbered one instance after another.

    Made by `of`, once for each structure, which has to be kept alive.

    Parameters
    ----------
    structure : InstancedStructure

    Attributes
    ----------
    solids : Solids
        Of the scene's meshes, each in the space of its object.
    is_closed : ndarray of shape (L,), bool
        Of each solid.
    corners : ndarray of shape (F, 3, 3), float32
        By prim_id, each in its object's local frame.
    records : tuple of two uint64
        Addresses of instances and objects, for `classify_placed_crossings`.
    """

    def __init__(self, structure: InstancedStructure) -> None:
        triangles: InstancedTriangles = structure.triangles
        self._triangles = triangles
        found = [
            solids_with(one) if one.has_primitives else solids_of(one) for one in triangles.objects
        ]
        counts = np.array([len(one.is_closed) for one in found], np.int64)
        ids = triangles.instances.object_ids
        first_rows = np.cumsum(counts) - counts
        of_instances = counts[ids]
        self._first_solids = np.concatenate([[0], np.cumsum(of_instances)]).astype(np.int64)
        # Of an instance: its first solid's number less the row of its object's first one.
        self._shifts = self._first_solids[:-1] - first_rows[ids]
        rows = np.arange(self._first_solids[-1]) - np.repeat(self._shifts, of_instances)
        self._rows, self._counts = rows, of_instances
        self._meshes, self._mesh_shifts = _mesh_rows(triangles, counts)
        columns = [*zip(*found, strict=True)] or [()] * len(Solids._fields)
        joined = [np.concatenate([[], *column]) for column in columns[:5]]
        self._volumes, is_closed = joined[4], joined[0].astype(bool)
        self.is_closed: NDArray[np.bool_] = is_closed[rows]
        closed, flipped, empty, has_slivers = map(self._by_mesh, joined[:4])
        is_closed_together = all(one.is_closed_together for one in found)
        self.solids = Solids(closed, flipped, empty, has_slivers, self._volumes, is_closed_together)
        self.corners = triangles.object_corners()
        self._instances = instance_records(triangles, np.arange(len(ids)))
        self._objects = object_records(structure.objects)
        addresses = [
            np.uint64(one.ctypes.data if len(one) else 0)
            for one in (self._instances, self._objects)
        ]
        self.records = _RecordsAt(*addresses)

    def _by_mesh(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Values of objects' solids by the scene's meshes."""
        found = np.zeros(len(self._triangles.mesh_splits) - 1, np.bool_)
        found[self._meshes] = values.astype(bool)
        return found

    @cached_property
    def volumes(self) -> NDArray[np.float64]:
        """Absolute volumes of the solids, shape (L,), in world units; see `Solids`."""
        linear = self._triangles.instances.transforms[:, :, :3]
        sizes = np.repeat(np.abs(np.linalg.det(linear)), self._counts)
        return self._volumes[self._rows] * sizes

    @classmethod
    def of(cls, structure: InstancedStructure) -> PlacedSolids:
        """The solids of a structure's instances."""
        found = _known.get(structure)
        if found is None:
            found = _known[structure] = cls(structure)
        return found

    def solids_at(
        self, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """The solids of triangles in instances."""
        held = self._triangles
        meshes = np.searchsorted(held.mesh_splits, prim_id, side="right") - 1
        objects = held.instances.object_ids[instance_id]
        rows = meshes + self._mesh_shifts[objects, held.parts_of(prim_id)]
        return (rows + self._shifts[instance_id]).astype(np.int32)

    def split(self, solid_ids: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The mesh and the instance of each solid."""
        instance_id = np.searchsorted(self._first_solids, solid_ids, side="right") - 1
        mesh_id = self._meshes[solid_ids - self._shifts[instance_id]]
        return mesh_id.astype(np.int32), instance_id.astype(np.int32)

    def in_object(
        self, solid_id: int, points: NDArray[np.float64]
    ) -> tuple[Triangles, int, NDArray[np.float64]]:
        """The object of a solid, the mesh's number in it, and points of shape (N, 3) there."""
        instance_id = int(np.searchsorted(self._first_solids, solid_id, side="right")) - 1
        instances = self._triangles.instances
        object_: Any = self._triangles.objects[instances.object_ids[instance_id]]
        object_ = object_.triangles if object_.has_primitives else object_
        inverse = instances.inverses[instance_id]
        mesh = solid_id - int(self._first_solids[instance_id])
        return object_, mesh, points @ inverse[:, :3].T + inverse[:, 3]


def _mesh_rows(
    triangles: InstancedTriangles, counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The scene's mesh that each solid of an object is, one object after another.

    And what is added to meshes for these rows, by object and part, see `InstancedTriangles.parts`.
    """
    firsts = np.searchsorted(triangles.first_fields, triangles.parts[:, 1, 1], side="left")
    mesh_count = len(triangles.mesh_splits) - 1 - len(triangles.fields)
    mesh_count -= int(len(triangles.spheres) > 0)
    meshes, shifts, row, first = [], np.zeros((len(counts), 3), np.int64), 0, 0
    for k, one in enumerate(triangles.objects):
        fields, spheres = len(one.fields), int(one.part_counts[2] > 0)
        own = int(counts[k]) - fields - spheres
        begins = first, mesh_count + int(firsts[k]), mesh_count + len(triangles.fields)
        sizes = own, fields, spheres
        for part, (begin, size) in enumerate(zip(begins, sizes, strict=True)):
            meshes.append(np.arange(begin, begin + size))
            shifts[k, part] = row - begin
            row += size
        first += own
    return np.concatenate([np.zeros(0, np.int64), *meshes]), shifts


_known: WeakKeyDictionary[InstancedStructure, PlacedSolids] = WeakKeyDictionary()


@kernel
def classify_placed_crossings(begin, end, source, records, hits, corners, is_flipped, crossings):
    """Classify crossings as entries or exits, in the spaces of the objects that are crossed.

    Parameters
    ----------
    begin, end : int
        Rays.
    source : RaySource
    records : tuple of two uint64
        See `PlacedSolids`.
    hits : tuple of two ndarray of shape (K,), int32
        The instance and the mesh of each crossing.
    corners : ndarray of shape (F, 3, 3), float32
    is_flipped : ndarray of shape (M,), bool
        Of meshes.
    crossings : Crossings
        `mesh_id` has solids; `kind` and `slack` are written.
    """
    instance_id, mesh_id = hits
    for i in range(np.uint64(begin), np.uint64(end)):
        first, last = crossings.splits[i], crossings.splits[i + np.uint64(1)]
        if first == last:
            continue
        for row in range(first, last):
            instance = InstanceRecord(records.instances, np.uint64(instance_id[row]))
            object_ = ObjectRecord(records.objects, np.uint64(instance.object_id))
            local = load_ray(source, i, object_, instance)
            ray = prepare_ray(local.origin, local.direction, object_.max_coordinate)
            is_inward = is_flipped[mesh_id[row]]
            classify_crossing(row, local, ray, object_, corners, is_inward, crossings)
