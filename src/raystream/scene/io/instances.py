"""Instances: copies of meshes, transformed to world space."""

from __future__ import annotations

from copy import copy
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.scene.mesh import Mesh

#: Maximum triangles after instancing: every copy is stored.
MAX_INSTANCED_TRIANGLES = 1 << 26

#: Maximum meshes after instancing: a mesh costs far more than a triangle.
MAX_INSTANCES = 1 << 20


class Shape(NamedTuple):
    """Positions and normals of a deformed mesh, shape (V, 3); normals None if it has none."""

    vertices: NDArray[Any]
    normals: NDArray[Any] | None


class TriangleBudget:
    """Counts triangles and meshes of instances, and rejects files that multiply too many.

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
        """Count one more instance; `FileFormatError` if that is too many."""
        self.triangle_count += max(len(mesh.faces), len(mesh.vertices) // 3)
        self.instance_count += 1
        if self.triangle_count > MAX_INSTANCED_TRIANGLES or self.instance_count > MAX_INSTANCES:
            raise FileFormatError(
                self.path,
                f"its instances add up to more than {MAX_INSTANCED_TRIANGLES:,} triangles "
                f"or {MAX_INSTANCES:,} meshes",
            )


def placed(mesh: Mesh, matrix: NDArray[np.float64], material_id: int | None = None) -> Mesh:
    """Transform a mesh to world space.

    Parameters
    ----------
    mesh : Mesh
        In object space.
    matrix : ndarray of shape (4, 4), float64
        Affine, for column vectors. If it mirrors, triangles are flipped to keep their front
        sides.
    material_id : int, optional
        The material of all triangles [default: unchanged].

    Returns
    -------
    Mesh
        The same mesh if nothing changes, else a new one with float64 vertices.
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
        face_ids=mesh.face_ids,
    )


class Placements:
    """Transforms the meshes of an animated scene, time after time.

    Meshes that did not move are the same objects; others share all but positions and normals.
    """

    def __init__(self) -> None:
        self._placed: dict[int, tuple[Mesh, NDArray[np.float64], Shape | None, Mesh]] = {}
        self._next = 0

    def begin(self) -> None:
        """Start again with the first place."""
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
        shape: Shape | None = None,
    ) -> Mesh:
        """Transform a mesh to the next place; see `placed`.

        Parameters
        ----------
        mesh, matrix, material_id
            As for `placed`; a place always has the same material.
        name : str, optional
            Name of the new mesh.
        shape : Shape, optional
            Of the mesh before it is placed [default: its own].
        """
        before = self._placed.get(self._next)
        if before is not None and before[0] is mesh:
            _, old_matrix, old_shape, old = before
            if shape is old_shape and np.array_equal(matrix, old_matrix):
                found = old
            elif _mirrors(matrix) == _mirrors(old_matrix):
                found = old.moved(*_transformed(shape or mesh, matrix))
            else:
                found = _shaped(mesh, matrix, material_id, shape)
                found = _named(found, mesh, old.name)
        else:
            found = _shaped(mesh, matrix, material_id, shape)
            found = found if name is None else _named(found, mesh, name)
        self._placed[self._next] = mesh, matrix, shape, found
        self._next += 1
        return found


def _named(found: Mesh, mesh: Mesh, name: str) -> Mesh:
    """Name a placed mesh: a copy, if it stays where it is, as others may do."""
    named = copy(found) if found is mesh else found
    named.name = name
    return named


def _shaped(
    mesh: Mesh, matrix: NDArray[np.float64], material_id: int | None, shape: Shape | None
) -> Mesh:
    found = placed(mesh, matrix, material_id)
    return found if shape is None else found.moved(*_transformed(shape, matrix))


def _transformed(
    mesh: Mesh | Shape, matrix: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[Any] | None]:
    """Return positions and normals in world space."""
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    with np.errstate(all="ignore"):
        vertices = mesh.vertices.astype(np.float64) @ linear.T + shift
        return vertices, _turned(mesh.normals, linear)


def _mirrors(matrix: NDArray[np.float64]) -> bool:
    with np.errstate(all="ignore"):
        return _determinant(matrix[:3, :3]) < 0.0


def _determinant(linear: NDArray[np.float64]) -> float:
    """Return the determinant; much faster than NumPy for one matrix."""
    (a, b, c), (d, e, f), (g, h, i) = linear.tolist()
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _turned(normals: NDArray[Any] | None, linear: NDArray[np.float64]) -> NDArray[Any] | None:
    """Transform normals by the cofactors, which need no inverse and preserve their side."""
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
    # NaN stays NaN: a vertex without a normal.
    return np.where(lengths == 0.0, 0.0, turned / lengths).astype(np.float32)
