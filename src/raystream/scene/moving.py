"""Moving the vertices of a scene's meshes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from raystream.scene.mesh import Mesh


def moved_meshes(meshes: Sequence[Mesh], vertices: Any) -> list[Mesh]:
    """Give meshes new positions.

    Parameters
    ----------
    meshes : sequence of Mesh
    vertices : array_like of shape (V, 3), real; or a sequence of them
        For one mesh, or one array per mesh; None leaves a mesh unchanged.

    Raises
    ------
    ValueError
        If the number of meshes, or of a mesh's vertices, differs.
    TypeError
        If they are not real numbers.
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


def have_same_faces(meshes: Sequence[Mesh], others: Sequence[Mesh]) -> bool:
    """Whether meshes have the same faces and numbers of vertices."""
    return len(meshes) == len(others) and all(map(_has_same_faces, meshes, others))


def same_faces(meshes: Sequence[Mesh], others: Sequence[Mesh]) -> Sequence[Mesh]:
    """Check that another scene's meshes differ in vertex positions only.

    Parameters
    ----------
    meshes, others : sequence of Mesh

    Returns
    -------
    sequence of Mesh
        `others`.

    Raises
    ------
    ValueError
        If the number of meshes, or a mesh's faces or number of vertices, differs.
    """
    if len(meshes) != len(others):
        raise ValueError(
            f"scene: expected {len(meshes)} meshes, as before, got {len(others)}; "
            "build a new tracer"
        )
    for index, (mesh, other) in enumerate(zip(meshes, others, strict=True)):
        if not _has_same_faces(mesh, other):
            raise ValueError(f"scene: mesh {index} has different faces; build a new tracer")
    return others


def _has_same_faces(mesh: Mesh, other: Mesh) -> bool:
    if mesh.faces is other.faces:
        return len(mesh.vertices) == len(other.vertices)
    return len(mesh.vertices) == len(other.vertices) and np.array_equal(mesh.faces, other.faces)


def _is_a_sequence_of_one(vertices: Any) -> bool:
    """Whether this is a list of one mesh's vertices, rather than the vertices themselves."""
    if not isinstance(vertices, list | tuple) or len(vertices) != 1:
        return False
    return vertices[0] is None or np.ndim(vertices[0]) == 2
