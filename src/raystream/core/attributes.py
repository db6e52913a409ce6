"""Attributes: materials, normals, colours and texture coordinates of a scene's triangles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class _Mesh(Protocol):
    """A `raystream.scene.mesh.Mesh`."""

    vertices: NDArray[Any]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    texcoords: NDArray[np.float32] | None
    material_ids: NDArray[np.int32]
    face_ids: NDArray[np.int32] | None


def faces_of(mesh: _Mesh) -> NDArray[np.int32]:
    """The face of each triangle of a mesh, shape (F,), int32."""
    return np.arange(len(mesh.faces), dtype=np.int32) if mesh.face_ids is None else mesh.face_ids


class Attributes:
    """Attributes of all triangles and vertices of a scene, one mesh after another.

    Tables are built when they are first read, and cached.

    Parameters
    ----------
    meshes : sequence of Mesh
    """

    def __init__(self, meshes: Sequence[_Mesh]) -> None:
        self._meshes = tuple(meshes)

    @property
    def vertex_count(self) -> int:
        """Number of vertices over all meshes: rows of the tables of vertices."""
        return sum(len(mesh.vertices) for mesh in self._meshes)

    @cached_property
    def material_ids(self) -> NDArray[np.int32]:
        """The material of each triangle, by prim_id, shape (F,), int32."""
        ids = [mesh.material_ids for mesh in self._meshes]
        return np.concatenate([np.zeros(0, np.int32), *ids])

    @cached_property
    def face_ids(self) -> NDArray[np.int32] | None:
        """The face of each triangle within its mesh, by prim_id, shape (F,), int32.

        None if each triangle of every mesh is a face.
        """
        if all(mesh.face_ids is None for mesh in self._meshes):
            return None
        return np.concatenate([faces_of(mesh) for mesh in self._meshes])

    @cached_property
    def faces(self) -> NDArray[np.int32]:
        """The rows of each triangle's vertices, by prim_id, shape (F, 3), int32."""
        counts = [len(mesh.vertices) for mesh in self._meshes]
        firsts = np.cumsum([0, *counts[:-1]])
        parts = [mesh.faces + first for mesh, first in zip(self._meshes, firsts, strict=False)]
        return np.concatenate([np.zeros((0, 3), np.int32), *parts]).astype(np.int32)

    @cached_property
    def normals(self) -> NDArray[np.float32] | None:
        """Shape (V, 3), float32; NaN where a mesh has none, None if no mesh has any."""
        return self._joined([mesh.normals for mesh in self._meshes], 3, np.nan)

    @cached_property
    def texcoords(self) -> NDArray[np.float32] | None:
        """Shape (V, 2), float32; NaN where a mesh has none, None if no mesh has any."""
        return self._joined([mesh.texcoords for mesh in self._meshes], 2, np.nan)

    @cached_property
    def colors(self) -> NDArray[np.float32] | None:
        """Linear RGB of shape (V, 3), float32; 1 where a mesh has none, None if none has any."""
        return self._joined([mesh.colors for mesh in self._meshes], 3, 1.0)

    def _joined(
        self, tables: Sequence[NDArray[np.float32] | None], width: int, missing: float
    ) -> NDArray[np.float32] | None:
        if all(table is None for table in tables):
            return None
        parts = [
            np.full((len(mesh.vertices), width), missing, np.float32) if table is None else table
            for mesh, table in zip(self._meshes, tables, strict=True)
        ]
        return np.concatenate(parts)
