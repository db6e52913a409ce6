"""Instances: copies of meshes, moved into world space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.mesh import Mesh

__all__ = ["TriangleBudget", "placed"]

#: Scenes that instances blow up beyond this are refused: every copy is stored.
MAX_INSTANCED_TRIANGLES = 1 << 26

#: Meshes cost far more than triangles; no scene needs as many.
MAX_INSTANCES = 1 << 20


class TriangleBudget:
    """Counts what instances add up to, and stops files that multiply without end.

    Parameters
    ----------
    path : Path
        The file, for the message.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.triangle_count = 0
        self.instance_count = 0

    def spend(self, mesh: Mesh) -> None:
        """Count one more instance; `FileFormatError` when it is too many."""
        self.triangle_count += max(len(mesh.faces), len(mesh.vertices) // 3)
        self.instance_count += 1
        if self.triangle_count > MAX_INSTANCED_TRIANGLES or self.instance_count > MAX_INSTANCES:
            raise FileFormatError(
                self.path,
                f"its instances add up to more than {MAX_INSTANCED_TRIANGLES:,} triangles "
                f"or {MAX_INSTANCES:,} meshes",
            )


def placed(mesh: Mesh, matrix: NDArray[np.float64], material_id: int | None = None) -> Mesh:
    """Move a mesh into world space.

    Parameters
    ----------
    mesh : Mesh
        In its own space.
    matrix : ndarray of shape (4, 4), float64
        Affine, for column vectors. When it mirrors, the triangles are turned over so that
        their fronts stay fronts.
    material_id : int, optional
        The material of all triangles; without it they keep theirs.

    Returns
    -------
    Mesh
        The same mesh when nothing changes, else a new one with float64 vertices.
    """
    if material_id is None and np.array_equal(matrix, np.eye(4)):
        return mesh
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    with np.errstate(all="ignore"):
        vertices = mesh.vertices.astype(np.float64) @ linear.T + shift
        mirrored = np.linalg.det(linear) < 0.0
        normals = _turned(mesh.normals, linear)
    faces = mesh.faces[:, [0, 2, 1]] if mirrored else mesh.faces
    return Mesh(
        vertices,
        faces,
        normals=normals,
        colors=mesh.colors,
        texcoords=mesh.texcoords,
        material_ids=mesh.material_ids if material_id is None else material_id,
        name=mesh.name,
    )


def _turned(
    normals: NDArray[np.float32] | None, linear: NDArray[np.float64]
) -> NDArray[Any] | None:
    """Turn normals with the cofactors, which need no inverse and keep their side."""
    if normals is None:
        return None
    rows = linear
    cofactors = np.stack(
        [np.cross(rows[1], rows[2]), np.cross(rows[2], rows[0]), np.cross(rows[0], rows[1])]
    )
    sign = -1.0 if np.linalg.det(linear) < 0.0 else 1.0
    turned = normals.astype(np.float64) @ (sign * cofactors).T
    lengths = np.linalg.norm(turned, axis=1)[:, None]
    return np.where(lengths > 0.0, turned / lengths, 0.0).astype(np.float32)
