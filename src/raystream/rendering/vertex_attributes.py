"""Vertex attributes as kernels read them: tables small enough for int32 indices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.scene import Scene

#: Most numbers of a table: kernels index it with int32.
MAX_NUMBERS = 2**31 - 1


def check_rows(count: int, width: int, what: str) -> None:
    """Check that kernels can index a table.

    Parameters
    ----------
    count, width : int
        Rows, and numbers per row.
    what : str
        Name of the rows, for the error message.

    Raises
    ------
    ValueError
        If the table has more than `MAX_NUMBERS` numbers.
    """
    most = MAX_NUMBERS // width
    if count > most:
        raise ValueError(
            f"scene: {count:,} {what} are more than the {most:,} that can be shaded; "
            "leave out meshes, or simplify them"
        )


class VertexAttributes(NamedTuple):
    """Vertex attributes of a scene's meshes; None if no mesh has them.

    Attributes
    ----------
    normals : ndarray of shape (V, 3), float32, or None
        NaN where a mesh has none.
    texcoords : ndarray of shape (V, 2), float32, or None
        NaN where a mesh has none.
    colors : ndarray of shape (V, 3), float32, or None
        Linear RGB; 1 where a mesh has none.
    faces : ndarray of shape (F, 3), int32
        Rows of these, by prim_id; empty without attributes.
    """

    normals: NDArray[np.float32] | None
    texcoords: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    faces: NDArray[np.int32]

    @classmethod
    def of(cls, scene: Scene) -> VertexAttributes:
        """Collect the attributes of a scene.

        Raises
        ------
        ValueError
            If there are too many, see `check_rows`.
        """
        known = scene.attributes
        faces = np.empty((0, 3), np.int32)
        if not (known.normals is None and known.texcoords is None and known.colors is None):
            check_rows(known.vertex_count, 3, "vertices with attributes")
            faces = known.faces
        colors = None if known.colors is None else np.ascontiguousarray(known.colors[:, :3])
        return cls(known.normals, known.texcoords, colors, faces)
