"""Vertex attributes as kernels take them: tables whose numbers they can count."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.scene import Scene

__all__ = ["MAX_NUMBERS", "VertexAttributes", "check_rows"]

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
        known = scene.attributes
        faces = np.empty((0, 3), np.int32)
        if not (known.normals is None and known.texcoords is None and known.colors is None):
            check_rows(known.vertex_count, 3, "vertices with attributes")
            faces = known.faces
        return cls(known.normals, known.texcoords, known.colors, faces)
