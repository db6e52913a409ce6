"""Mesh: the triangles of one object with their vertex attributes."""

from __future__ import annotations

import copy
from contextlib import nullcontext
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.masks import ALL_BITS, as_mask
from raystream.core.rays import as_integers


class Mesh:
    """Triangles over shared vertices, with optional attributes.

    A mesh copies its arrays and is immutable.

    Parameters
    ----------
    vertices : array_like of shape (V, 3), float
        Positions in world space, scene units. float32 stays float32, every other dtype
        becomes float64. A NaN or infinite position is allowed: triangles that use it are
        never hit, and :attr:`Scene.skipped_count` counts them.
    faces : array_like of shape (F, 3), integer
        Vertex indices of each triangle, counter-clockwise seen from the front.
    normals : array_like of shape (V, 3), float, optional
        Shading normals; need not be unit length. NaN for vertices without one.
    colors : array_like of shape (V, 3) or (V, 4), float, optional
        Linear RGB in [0, 1], multiplied by the material's diffuse colour; and an alpha in [0, 1],
        multiplied by the material's opacity.
    texcoords : array_like of shape (V, 2), float, optional
        Texture coordinates; (0, 0) is the lower left corner of the image. NaN for vertices without.
    material_ids : int or array_like of shape (F,), integer, optional
        Index of each triangle's material in :attr:`Scene.materials`.
    name : str, optional
        Label; need not be unique.
    face_ids : array_like of shape (F,), integer, optional
        The face of each triangle, from 0: triangles of one polygon have the same. Readers number
        the polygons of a file within each mesh [default: each triangle is a face, None].
    mask : int, optional
        32 bits, unsigned, not 0: a ray hits the mesh only if its own mask has one of these bits;
        see `Tracer.first_hit` [default: all bits].

    Raises
    ------
    ValueError
        If a shape is wrong, or an index lies outside its array.
    TypeError
        If an array's dtype is of the wrong kind.
    """

    __slots__ = (
        "colors",
        "face_ids",
        "faces",
        "mask",
        "material_ids",
        "name",
        "normals",
        "texcoords",
        "vertices",
    )

    vertices: NDArray[Any]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    texcoords: NDArray[np.float32] | None
    material_ids: NDArray[np.int32]
    name: str
    face_ids: NDArray[np.int32] | None
    mask: int

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        texcoords: ArrayLike | None = None,
        material_ids: ArrayLike = 0,
        name: str = "",
        face_ids: ArrayLike | None = None,
        mask: int = ALL_BITS,
    ) -> None:
        self.vertices = _vertices(vertices)
        count = len(self.vertices)
        self.faces = _faces(faces, count)
        self.normals = _attribute("normals", normals, (count, 3))
        self.colors = _attribute("colors", colors, (count, 3), (count, 4))
        self.texcoords = _attribute("texcoords", texcoords, (count, 2))
        self.material_ids = _material_ids(material_ids, len(self.faces))
        self.name = str(name)
        self.face_ids = _face_ids(face_ids, len(self.faces))
        self.mask = as_mask("mask", mask)

    @property
    def triangle_count(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    def moved(self, vertices: ArrayLike, normals: ArrayLike | None = None) -> Mesh:
        """Copy the mesh with new positions; everything else is shared.

        Parameters
        ----------
        vertices : array_like of shape (V, 3), float
            The same number as before.
        normals : array_like of shape (V, 3), float, optional
            Shading normals [default: the current ones, unchanged].

        Raises
        ------
        ValueError
            If the number of vertices or normals differs.
        TypeError
            If they are not real numbers.
        """
        positions = _vertices(vertices)
        if len(positions) != len(self.vertices):
            raise ValueError(
                f"vertices: expected {len(self.vertices):,}, as before, got {len(positions):,}"
            )
        mesh = copy.copy(self)
        mesh.vertices = positions
        if normals is not None:
            mesh.normals = _attribute("normals", normals, (len(positions), 3))
        return mesh

    def with_material_ids(self, material_ids: ArrayLike) -> Mesh:
        """Copy the mesh with other materials; everything else is shared.

        Parameters
        ----------
        material_ids : int or array_like of shape (F,), integer

        Raises
        ------
        ValueError, TypeError
            As `Mesh`.
        """
        mesh = copy.copy(self)
        mesh.material_ids = _material_ids(material_ids, len(self.faces))
        return mesh

    def with_mask(self, mask: int) -> Mesh:
        """Copy the mesh with another mask; everything else is shared.

        Parameters
        ----------
        mask : int

        Raises
        ------
        ValueError, TypeError
            As `Mesh`.
        """
        other = copy.copy(self)
        other.mask = as_mask("mask", mask)
        return other

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"Mesh({name}{len(self.vertices):,} vertices, {len(self.faces):,} triangles)"


def _vertices(vertices: ArrayLike) -> NDArray[Any]:
    array = np.asarray(vertices)
    if array.size == 0:
        array = array.reshape(0, 3).astype(np.float32)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"vertices: expected real numbers, got dtype {array.dtype}")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"vertices: expected shape (V, 3), got {array.shape}")
    dtype = np.float32 if array.dtype == np.float32 else np.float64
    return _kept(array, dtype)


def _faces(faces: ArrayLike, vertex_count: int) -> NDArray[np.int32]:
    array = np.asarray(faces)
    if array.size == 0:
        return _kept(np.zeros((0, 3)), np.int32)
    if array.dtype.kind not in "iu":
        raise TypeError(f"faces: expected integers, got dtype {array.dtype}")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"faces: expected shape (F, 3), got {array.shape}")
    low, high = int(array.min()), int(array.max())
    if low < 0 or high >= vertex_count:
        bad = low if low < 0 else high
        raise ValueError(f"faces: vertex index {bad} is outside 0..{vertex_count - 1}")
    return _kept(array, np.int32)


def _attribute(
    name: str, values: ArrayLike | None, *shapes: tuple[int, int]
) -> NDArray[np.float32] | None:
    if values is None:
        return None
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected real numbers, got dtype {array.dtype}")
    if array.shape not in shapes:
        expected = " or ".join(map(str, shapes))
        raise ValueError(
            f"{name}: expected shape {expected} to match the vertices, got {array.shape}"
        )
    return _kept(array, np.float32)


def _material_ids(material_ids: ArrayLike, face_count: int) -> NDArray[np.int32]:
    array = as_integers("material_ids", material_ids)
    if array.ndim and array.shape != (face_count,):
        raise ValueError(f"material_ids: expected shape ({face_count},), got {array.shape}")
    if face_count and int(array.min()) < 0:
        raise ValueError(f"material_ids: {int(array.min())} is negative")
    # One number for all faces is kept once.
    return np.broadcast_to(_kept(array, np.int32), (face_count,))


def _face_ids(face_ids: ArrayLike | None, face_count: int) -> NDArray[np.int32] | None:
    """The numbers, or None if each triangle is a face."""
    if face_ids is None:
        return None
    array = as_integers("face_ids", face_ids)
    if array.shape != (face_count,):
        raise ValueError(f"face_ids: expected shape ({face_count},), got {array.shape}")
    if face_count and not (array.min() >= 0 and array.max() < 2**31):
        raise ValueError(f"face_ids: expected 0 to 2**31 - 1, got {array.min()} to {array.max()}")
    return None if np.array_equal(array, np.arange(face_count)) else _kept(array, np.int32)


def _kept(array: NDArray[Any], dtype: type) -> NDArray[Any]:
    """Make a read-only copy: structures built from it would not follow changes."""
    may_overflow = array.dtype.kind == "f" and array.dtype != dtype
    # To silence the warning takes as long as to copy a small array.
    with np.errstate(over="ignore") if may_overflow else nullcontext():
        copy: NDArray[Any] = np.array(array, dtype, order="C")
    copy.setflags(write=False)
    return copy
