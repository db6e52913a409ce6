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
    mask: int


def faces_of(mesh: _Mesh) -> NDArray[np.int32]:
    """The face of each triangle of a mesh, shape (F,), int32."""
    return np.arange(len(mesh.faces), dtype=np.int32) if mesh.face_ids is None else mesh.face_ids


class Attributes:
    """Attributes of all triangles and vertices of a scene, one mesh after another.

    Tables are built when they are first read, and cached.

    Parameters
    ----------
    meshes : sequence of Mesh
    masks : ndarray of shape (M,), uint32, optional
        Those of meshes that are not known [default: the meshes']
    """

    def __init__(self, meshes: Sequence[_Mesh], masks: NDArray[np.uint32] | None = None) -> None:
        self._meshes = tuple(meshes)
        if masks is not None:
            self.masks = masks

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
    def masks(self) -> NDArray[np.uint32]:
        """The mask of each mesh, shape (M,), uint32."""
        return np.array([mesh.mask for mesh in self._meshes], np.uint32)

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
        """Linear RGB of shape (V, 3), float32; 1 where a mesh has none, None if none has any.

        Of shape (V, 4), with alpha, if a mesh has that; others have an alpha of 1.
        """
        tables = [mesh.colors for mesh in self._meshes]
        width = max((one.shape[1] for one in tables if one is not None), default=3)
        return self._joined(tables, width, 1.0)

    @cached_property
    def alphas(self) -> NDArray[np.float32] | None:
        """The alpha of colours, shape (V, 1), float32; None if it is 1 everywhere."""
        if all(mesh.colors is None or mesh.colors.shape[1] == 3 for mesh in self._meshes):
            return None
        assert self.colors is not None
        alphas = np.ascontiguousarray(self.colors[:, 3:])
        return None if (alphas == 1.0).all() else alphas

    @cached_property
    def faint_materials(self) -> frozenset[int]:
        """Materials of triangles with a vertex whose alpha is below 1."""
        if self.alphas is None:
            return frozenset()
        is_faint = ~(self.alphas[self.faces, 0] >= 1.0).all(axis=1)
        return frozenset(self.material_ids[is_faint].tolist())

    def _joined(
        self, tables: Sequence[NDArray[np.float32] | None], width: int, missing: float
    ) -> NDArray[np.float32] | None:
        if all(table is None for table in tables):
            return None
        parts = []
        for mesh, table in zip(self._meshes, tables, strict=True):
            part = table
            if part is None or part.shape[1] < width:
                part = np.full((len(mesh.vertices), width), missing, np.float32)
                if table is not None:
                    part[:, : table.shape[1]] = table
            parts.append(part)
        return np.concatenate(parts)
