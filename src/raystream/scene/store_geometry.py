"""Geometry of scenes from stores, for structures that come without a scene."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.scene.geometry import Geometry
from raystream.scene.instancing import InstancedGeometry
from raystream.scene.mesh import Mesh
from raystream.scene.primitive_geometry import PrimitiveGeometry


def geometry_of_store(store: Any) -> Geometry:
    """The geometry of a scene whose store is given, with masks and without other attributes."""
    if store.instances is not None:
        objects = [geometry_of_store(one) for one in store.objects]
        return InstancedGeometry(objects, store.instances)
    if store.has_primitives:
        meshes = _bare_meshes(store.triangles, store.mesh_masks)
        return PrimitiveGeometry(meshes, store.fields, store.spheres, store.shapes)
    return Geometry(_bare_meshes(store, store.mesh_masks), store)


def _bare_meshes(triangles: Any, masks: NDArray[np.uint32]) -> list[Mesh]:
    """The meshes of triangles, with nothing but these masks."""
    ids = np.arange(len(triangles), dtype=np.int32)
    local: Any = triangles.corners_at(ids, ids) if triangles.kinds else triangles.corners
    corners = triangles.points_to_world(local, ids)
    meshes = []
    parts = itertools.pairwise(triangles.mesh_splits)
    for (first, end), mask in zip(parts, masks.tolist(), strict=True):
        faces = np.arange(3 * (end - first), dtype=np.int32).reshape(-1, 3)
        meshes.append(Mesh(corners[first:end].reshape(-1, 3), faces, mask=mask))
    return meshes
