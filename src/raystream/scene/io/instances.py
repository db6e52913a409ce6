"""Instances: copies of meshes, moved into world space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.mesh import Mesh

__all__ = ["Placements", "TriangleBudget", "placed"]

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
    vertices, normals = _transformed(mesh, matrix)
    faces = mesh.faces[:, [0, 2, 1]] if _mirrors(matrix) else mesh.faces
    return Mesh(
        vertices,
        faces,
        normals=normals,
        colors=mesh.colors,
        texcoords=mesh.texcoords,
        material_ids=mesh.material_ids if material_id is None else material_id,
        name=mesh.name,
    )


class Placements:
    """Places the meshes of a scene again and again, as it moves.

    What did not move since is the same object; what did shares all but its positions and
    normals.
    """

    def __init__(self) -> None:
        self._placed: dict[int, tuple[Mesh, NDArray[np.float64], Mesh]] = {}
        self._next = 0

    def begin(self) -> None:
        """Begin with the first place."""
        self._next = 0

    def skip(self) -> None:
        """Leave the next place empty this time."""
        self._next += 1

    def place(
        self,
        mesh: Mesh,
        matrix: NDArray[np.float64],
        material_id: int | None = None,
        name: str | None = None,
    ) -> Mesh:
        """Move a mesh to the next place; see `placed`.

        Parameters
        ----------
        mesh, matrix, material_id
            As for `placed`; a place always has the same material.
        name : str, optional
            Of the new mesh.
        """
        before = self._placed.get(self._next)
        if before is not None and before[0] is mesh:
            _, old_matrix, old = before
            if np.array_equal(matrix, old_matrix):
                found = old
            elif _mirrors(matrix) == _mirrors(old_matrix):
                found = old.moved(*_transformed(mesh, matrix))
            else:
                found = placed(mesh, matrix, material_id)
                found.name = old.name
        else:
            found = placed(mesh, matrix, material_id)
            found.name = found.name if name is None else name
        self._placed[self._next] = mesh, matrix, found
        self._next += 1
        return found


def _transformed(
    mesh: Mesh, matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
    """Positions and normals in world space."""
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    with np.errstate(all="ignore"):
        vertices = mesh.vertices.astype(np.float64) @ linear.T + shift
        return vertices, _turned(mesh.normals, linear)


def _mirrors(matrix: NDArray[np.float64]) -> bool:
    with np.errstate(all="ignore"):
        return _determinant(matrix[:3, :3]) < 0.0


def _determinant(linear: NDArray[np.float64]) -> float:
    """Much faster than NumPy's for one matrix."""
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _turned(
    normals: NDArray[np.float32] | None, linear: NDArray[np.float64]
) -> NDArray[Any] | None:
    """Turn normals with the cofactors, which need no inverse and keep their side."""
    if normals is None:
        return None
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    cofactors = np.array(
        [
            [e * i - f * h, f * g - d * i, d * h - e * g],
            [h * c - i * b, i * a - g * c, g * b - h * a],
            [b * f - c * e, c * d - a * f, a * e - b * d],
        ]
    )
    sign = -1.0 if _determinant(linear) < 0.0 else 1.0
    turned = normals.astype(np.float64) @ (sign * cofactors).T
    lengths = np.linalg.norm(turned, axis=1)[:, None]
    return np.where(lengths > 0.0, turned / lengths, 0.0).astype(np.float32)
