"""Parts: triangles over shared vertices, their copies, and the meshes made of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Part", "copies", "merged"]


class Part(NamedTuple):
    """Triangles over shared vertices.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float32
    faces : ndarray of shape (F, 3), int32
        Vertex indices, counter-clockwise seen from the front.
    normals : ndarray of shape (V, 3), float32, or None
        Unit shading normals; None for a part with flat faces.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None = None

    def flipped(self) -> Part:
        """Return the part with its front and back sides swapped."""
        normals = None if self.normals is None else -self.normals
        return Part(self.vertices, np.ascontiguousarray(self.faces[:, ::-1]), normals)


def merged(parts: Sequence[Part]) -> Part:
    """Concatenate parts; either all of them have normals, or none."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + np.int32(start) for part, start in zip(parts, starts, strict=False)]
    normals = [part.normals for part in parts if part.normals is not None]
    return Part(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate(faces),
        np.concatenate(normals) if normals else None,
    )


def copies(part: Part, matrices: ArrayLike, offsets: ArrayLike) -> Part:
    """Make N transformed copies of a part.

    Parameters
    ----------
    part : Part
        The template.
    matrices : array_like of shape (N, 3, 3), float
        A vertex p goes to ``matrix @ p + offset``. Determinants must be positive, to preserve
        front sides.
    offsets : array_like of shape (N, 3), float
    """
    matrix = np.asarray(matrices, np.float32)
    offset = np.asarray(offsets, np.float32)
    starts = np.arange(len(matrix), dtype=np.int32) * np.int32(len(part.vertices))
    faces = (part.faces[None] + starts[:, None, None]).reshape(-1, 3)
    normals = None
    if part.normals is not None:
        normals = _transformed(part.normals, _cofactors(matrix))
        normals /= np.sqrt(np.einsum("...k,...k->...", normals, normals))[..., None]
        normals = normals.reshape(-1, 3)
    vertices = _transformed(part.vertices, matrix)
    vertices += offset[:, None, :]
    return Part(vertices.reshape(-1, 3), faces, normals)


def _transformed(points: NDArray[np.float32], matrix: NDArray[np.float32]) -> NDArray[np.float32]:
    """Multiply every matrix with every point: (V, 3) and (N, 3, 3) give (N, V, 3)."""
    result = np.empty((len(matrix), len(points), 3), np.float32)
    for row in range(3):  # one axis at a time: no BLAS, whose sums may depend on the machine
        axis = result[:, :, row]
        np.multiply(matrix[:, row, 0, None], points[None, :, 0], out=axis)
        axis += matrix[:, row, 1, None] * points[None, :, 1]
        axis += matrix[:, row, 2, None] * points[None, :, 2]
    return result


def _cofactors(matrix: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the matrices of normals: the inverse transpose times the determinant."""
    x, y, z = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=1)
