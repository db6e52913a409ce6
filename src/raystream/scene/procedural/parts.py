"""Parts: building blocks of procedural scenes, and their copies: merged, or as instances."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.scene.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles over shared vertices, from which meshes are made.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float32
        Positions, scene units.
    faces : ndarray of shape (F, 3), int32
        Vertex indices, counter-clockwise seen from the front.
    material_ids : ndarray of shape (F,), int32
        Index of each triangle's material.
    normals : ndarray of shape (V, 3), float32, or None
        Unit shading normals; None for a part with flat faces.
    colors : ndarray of shape (V, 3), float32, or None
        Linear RGB, multiplied with the material's diffuse colour; None is white.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    material_ids: NDArray[np.int32]
    normals: NDArray[np.float32] | None = None
    colors: NDArray[np.float32] | None = None

    @property
    def triangle_count(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    def painted(self, material_id: int) -> Part:
        """Return the part with one material for all its triangles."""
        return replace(self, material_ids=np.full(len(self.faces), material_id, np.int32))

    def flipped(self) -> Part:
        """Return the part with its front and back sides swapped."""
        normals = None if self.normals is None else -self.normals
        faces = np.ascontiguousarray(self.faces[:, ::-1])
        return replace(self, faces=faces, normals=normals)


def merge(parts: Sequence[Part]) -> Part:
    """Concatenate parts.

    Parameters
    ----------
    parts : sequence of Part
        Either all of them have normals, or none. A part without colours becomes white if
        another one has colours.

    Returns
    -------
    Part

    Raises
    ------
    ValueError
        If some parts have normals and others do not.
    """
    smooth = [part.normals is not None for part in parts]
    if any(smooth) and not all(smooth):
        raise ValueError("parts: smooth and flat parts cannot share a mesh")
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + np.int32(start) for part, start in zip(parts, starts, strict=False)]
    colors = None
    if any(part.colors is not None for part in parts):
        colors = np.concatenate([_colors(part) for part in parts])
    normals = None
    if any(smooth):
        normals = np.concatenate([part.normals for part in parts if part.normals is not None])
    return Part(
        np.concatenate([part.vertices for part in parts])
        if parts
        else np.zeros((0, 3), np.float32),
        np.concatenate(faces) if parts else np.zeros((0, 3), np.int32),
        np.concatenate([p.material_ids for p in parts]) if parts else np.zeros(0, np.int32),
        normals,
        colors,
    )


def instance(
    part: Part,
    matrices: ArrayLike,
    offsets: ArrayLike,
    *,
    material_ids: ArrayLike | None = None,
    colors: ArrayLike | None = None,
) -> Part:
    """Make N transformed copies of a part.

    Parameters
    ----------
    part : Part
        The template.
    matrices : array_like of shape (N, 3, 3), float
        Column-vector convention: a vertex p goes to ``matrix @ p + offset``. Determinants
        must be positive, to preserve front sides.
    offsets : array_like of shape (N, 3), float
    material_ids : array_like of shape (N,), integer, optional
        Material of each copy, instead of the template's.
    colors : array_like of shape (N, 3), float, optional
        Colour of each copy, multiplied with the template's.

    Returns
    -------
    Part
        Copy i owns the triangles [i * F, (i + 1) * F) of the template's F.
    """
    matrix = np.asarray(matrices, np.float32)
    offset = np.asarray(offsets, np.float32)
    count, vertex_count = len(matrix), len(part.vertices)
    starts = np.arange(count, dtype=np.int32) * np.int32(vertex_count)
    faces = (part.faces[None] + starts[:, None, None]).reshape(-1, 3)
    if material_ids is None:
        ids = np.tile(part.material_ids, count)
    else:
        ids = np.repeat(np.asarray(material_ids, np.int32), len(part.faces))
    normals = None
    if part.normals is not None:
        normals = _transform(part.normals, _cofactors(matrix))
        normals /= np.sqrt(np.einsum("...k,...k->...", normals, normals))[..., None]
        normals = normals.reshape(-1, 3)
    tint = None
    if colors is not None:
        rows = np.asarray(colors, np.float32)[:, None, :]
        tint = (rows * _colors(part)[None]).reshape(-1, 3)
    elif part.colors is not None:
        tint = np.tile(part.colors, (count, 1))
    vertices = _transform(part.vertices, matrix)
    vertices += offset[:, None, :]
    return Part(vertices.reshape(-1, 3), faces, ids, normals, tint)


class PartCopies(NamedTuple):
    """Copies of a part.

    Attributes
    ----------
    shape : Part
        Around the origin, with its material.
    matrices, offsets, colors : ndarray of shape (N, 3, 3), (N, 3) and (N, 3), float
        See `instance`.
    """

    shape: Part
    matrices: NDArray[np.floating[Any]]
    offsets: NDArray[np.floating[Any]]
    colors: NDArray[np.floating[Any]]


def merge_copies(copies: Iterable[PartCopies]) -> Part:
    """Make one part of all copies, ordered by shape, then by copy."""
    return merge([instance(one.shape, *one[1:3], colors=one.colors) for one in copies])


class Separate(NamedTuple):
    """Copies as a scene's instances.

    Attributes
    ----------
    objects : list of Part
        Each shape in each of its colours.
    object_ids : ndarray of shape (N,), int64
        The object of each copy.
    transforms : ndarray of shape (N, 3, 4), float64
    """

    objects: list[Part]
    object_ids: NDArray[np.int64]
    transforms: NDArray[np.float64]


def separate_copies(copies: Iterable[PartCopies]) -> Separate:
    """Make an object of each shape in each of its colours, and an instance of each copy."""
    objects: list[Part] = []
    ids, transforms = [np.zeros(0, np.int64)], [np.zeros((0, 3, 4))]
    for one in copies:
        colors, which = np.unique(one.colors, axis=0, return_inverse=True)
        ids.append(len(objects) + which.reshape(-1))
        transforms.append(np.concatenate([one.matrices, one.offsets[:, :, None]], axis=2))
        place = [np.eye(3)], np.zeros((1, 3))
        objects += [instance(one.shape, *place, colors=[color]) for color in colors]
    return Separate(objects, np.concatenate(ids), np.concatenate(transforms))


def yaw(angles: ArrayLike, scales: ArrayLike = 1.0) -> NDArray[np.float32]:
    """Make matrices that scale, then rotate about the y axis.

    Parameters
    ----------
    angles : array_like of shape (N,), float
        Radians, counter-clockwise seen from above.
    scales : array_like of shape (N,), (N, 3) or (), float
        Factor of each copy, or of each of its axes.

    Returns
    -------
    ndarray of shape (N, 3, 3), float32
    """
    angle = np.asarray(angles, np.float64)
    scale = np.asarray(scales, np.float64)
    if scale.ndim < 2:
        scale = np.broadcast_to(scale, angle.shape)[:, None]
    matrix = np.zeros((len(angle), 3, 3))
    matrix[:, 0, 0] = matrix[:, 2, 2] = np.cos(angle)
    matrix[:, 0, 2] = np.sin(angle)
    matrix[:, 2, 0] = -matrix[:, 0, 2]
    matrix[:, 1, 1] = 1.0
    return (matrix * scale[:, None, :]).astype(np.float32)


def to_mesh(part: Part, name: str, *, texcoords: NDArray[np.float32] | None = None) -> Mesh:
    """Convert a part to a mesh."""
    return Mesh(
        part.vertices,
        part.faces,
        normals=part.normals,
        colors=part.colors,
        texcoords=texcoords,
        material_ids=part.material_ids,
        name=name,
    )


def _colors(part: Part) -> NDArray[np.float32]:
    return np.ones_like(part.vertices) if part.colors is None else part.colors


def _transform(points: NDArray[np.float32], matrix: NDArray[np.float32]) -> NDArray[np.float32]:
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
