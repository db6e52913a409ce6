"""Vertex attributes of a whole scene, one mesh after another, and the faces that refer to them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.scene import Scene

__all__ = ["MAX_NUMBERS", "VertexAttributes", "check_rows", "material_ids_of"]

#: Of a table: kernels count them in int32.
MAX_NUMBERS = 2**31 - 1


def check_rows(count: int, width: int, what: str) -> None:
    """Check that kernels can count the numbers of a table.

    Parameters
    ----------
    count, width : int
        Rows, and numbers in each.
    what : str
        What rows stand for.

    Raises
    ------
    ValueError
        If they are more than `MAX_NUMBERS`.
    """
    most = MAX_NUMBERS // width
    if count > most:
        raise ValueError(
            f"scene: {count:,} {what} are more than the {most:,} that can be shaded; "
            "leave meshes out, or simplify them"
        )


class VertexAttributes(NamedTuple):
    """What meshes know of their vertices; None if no mesh does.

    Attributes
    ----------
    normals : ndarray of shape (V, 3), float32, or None
        NaN where a mesh has none.
    texcoords : ndarray of shape (V, 2), float32, or None
        NaN where a mesh has none.
    colors : ndarray of shape (V, 3), float32, or None
        Linear RGB; 1 where a mesh has none.
    faces : ndarray of shape (F, 3), int32
        Rows of these, by prim_id; empty if there are none.
    """

    normals: NDArray[np.float32] | None
    texcoords: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    faces: NDArray[np.int32]

    @classmethod
    def of(cls, scene: Scene) -> VertexAttributes:
        """Those of a scene.

        Raises
        ------
        ValueError
            If kernels cannot count them, see `check_rows`.
        """
        normals = _joined([mesh.normals for mesh in scene.meshes], scene, 3, np.nan)
        texcoords = _joined([mesh.texcoords for mesh in scene.meshes], scene, 2, np.nan)
        colors = _joined([mesh.colors for mesh in scene.meshes], scene, 3, 1.0)
        faces = np.empty((0, 3), np.int32)
        if not (normals is None and texcoords is None and colors is None):
            counts = [len(mesh.vertices) for mesh in scene.meshes]
            check_rows(sum(counts), 3, "vertices with attributes")
            firsts = np.cumsum([0, *counts[:-1]])
            parts = [m.faces + first for m, first in zip(scene.meshes, firsts, strict=True)]
            faces = np.concatenate(parts).astype(np.int32)
        return cls(normals, texcoords, colors, faces)


def material_ids_of(scene: Scene) -> NDArray[np.int32]:
    """The material of each triangle, shape (F,)."""
    ids = [mesh.material_ids for mesh in scene.meshes]
    return np.concatenate(ids).astype(np.int32) if ids else np.empty(0, np.int32)


def _joined(
    attributes: Sequence[NDArray[np.float32] | None], scene: Scene, width: int, missing: float
) -> NDArray[np.float32] | None:
    """The attribute of all meshes' vertices, one after another; None if no mesh has it."""
    if all(attribute is None for attribute in attributes):
        return None
    parts = [
        np.full((len(mesh.vertices), width), missing, np.float32)
        if attribute is None
        else attribute
        for mesh, attribute in zip(scene.meshes, attributes, strict=True)
    ]
    return np.concatenate(parts)
