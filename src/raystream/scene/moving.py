"""Moving the vertices of a scene's meshes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from raystream.scene.mesh import Mesh

__all__ = ["moved_meshes"]


def moved_meshes(meshes: Sequence[Mesh], vertices: Any) -> list[Mesh]:
    """Give meshes new positions.

    Parameters
    ----------
    meshes : sequence of Mesh
    vertices : array_like of shape (V, 3), real; or a sequence of them
        For one mesh, or an array for each of them; None leaves a mesh where it is.

    Raises
    ------
    ValueError
        If their number, or the number of a mesh's vertices, is another one.
    TypeError
        If they are no real numbers.
    """
    if len(meshes) == 1 and not _is_a_sequence_of_one(vertices):
        vertices = [vertices]
    if len(vertices) != len(meshes):
        raise ValueError(
            f"vertices: expected an array for each of {len(meshes)} meshes, got {len(vertices)}"
        )
    moved = []
    for index, (mesh, positions) in enumerate(zip(meshes, vertices, strict=True)):
        try:
            moved.append(mesh if positions is None else mesh.moved(positions))
        except (TypeError, ValueError) as error:
            if len(meshes) == 1:
                raise
            raise type(error)(f"mesh {index}: {error}") from None
    return moved


def _is_a_sequence_of_one(vertices: Any) -> bool:
    """Whether it is a mesh's vertices in a list, not a mesh's vertices."""
    if not isinstance(vertices, list | tuple) or len(vertices) != 1:
        return False
    return vertices[0] is None or np.ndim(vertices[0]) == 2
