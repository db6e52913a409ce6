"""Crossings of meshes in instances: each mesh of each instance is a solid of its own."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple
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
        found = [solids_of(one) for one in triangles.objects]
        none = np.zeros(0, bool)
        self.solids = Solids(
            np.concatenate([none, *(one.is_closed for one in found)]),
            np.concatenate([none, *(one.is_flipped for one in found)]),
            np.concatenate([none, *(one.is_empty for one in found)]),
            np.concatenate([none, *(one.has_slivers for one in found)]),
            np.concatenate([np.zeros(0), *(one.volumes for one in found)]),
            all(one.is_closed_together for one in found),
        )
        counts = np.array([len(one.is_closed) for one in found], np.int64)
        ids = triangles.instances.object_ids
        first_meshes = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        of_instances = counts[ids] if len(ids) else np.zeros(0, np.int64)
        self._first_solids = np.concatenate([[0], np.cumsum(of_instances)]).astype(np.int64)
        # Of an instance: its first solid's number less its object's first mesh.
        self._shifts = self._first_solids[:-1] - first_meshes[:-1][ids]
        rows = np.arange(self._first_solids[-1]) - np.repeat(self._shifts, of_instances)
        self.is_closed: NDArray[np.bool_] = self.solids.is_closed[rows]
        self._rows, self._counts = rows, of_instances
        self.corners = triangles.object_corners()
        self._instances = instance_records(triangles, np.arange(len(ids)))
        self._objects = object_records(structure.objects)
        addresses = [
            np.uint64(one.ctypes.data if len(one) else 0)
            for one in (self._instances, self._objects)
        ]
        self.records = _RecordsAt(*addresses)

    @cached_property
    def volumes(self) -> NDArray[np.float64]:
        """Absolute volumes of the solids, shape (L,), in world units; see `Solids`."""
        linear = self._triangles.instances.transforms[:, :, :3]
        sizes = np.repeat(np.abs(np.linalg.det(linear)), self._counts)
        return self.solids.volumes[self._rows] * sizes

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
        meshes = np.searchsorted(self._triangles.mesh_splits, prim_id, side="right") - 1
        return (meshes + self._shifts[instance_id]).astype(np.int32)

    def split(self, solid_ids: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """The mesh and the instance of each solid."""
        instance_id = np.searchsorted(self._first_solids, solid_ids, side="right") - 1
        mesh_id = solid_ids - self._shifts[instance_id]
        return mesh_id.astype(np.int32), instance_id.astype(np.int32)

    def in_object(
        self, solid_id: int, points: NDArray[np.float64]
    ) -> tuple[Triangles, int, NDArray[np.float64]]:
        """The object of a solid, the mesh's number in it, and points of shape (N, 3) there."""
        instance_id = int(np.searchsorted(self._first_solids, solid_id, side="right")) - 1
        instances = self._triangles.instances
        object_ = self._triangles.objects[instances.object_ids[instance_id]]
        inverse = instances.inverses[instance_id]
        mesh = solid_id - int(self._first_solids[instance_id])
        return object_, mesh, points @ inverse[:, :3].T + inverse[:, 3]


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
