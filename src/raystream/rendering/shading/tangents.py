"""Vertex tangents: directions in which the texture coordinate u increases."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.vertex_attributes import VertexAttributes


def vertex_tangents(
    corners: NDArray[np.float32], vertices: VertexAttributes, is_wanted: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Average the triangles' tangents at each vertex, weighted by angle.

    Parameters
    ----------
    corners : ndarray of shape (F, 3, 3), float32
    vertices : VertexAttributes
        With texture coordinates.
    is_wanted : ndarray of shape (F,), bool
        Triangles to include.

    Returns
    -------
    ndarray of shape (2, V, 3), float32
        Of triangles with unmirrored and with mirrored texture coordinates: the two must not be
        averaged where they meet, as along a face's symmetry axis. Of length about 1; 0 for
        vertices without tangents.

    Notes
    -----
    Mikkelsen's tangents, as glTF specifies: "Simulation of Wrinkled Surfaces Revisited", 2008;
    but triangles are grouped by the vertices of the file.
    """
    texcoords = vertices.texcoords
    assert texcoords is not None
    sums = np.zeros((2, len(texcoords), 3))
    faces = vertices.faces[is_wanted]
    places = corners[is_wanted].astype(np.float64)
    first, second = np.moveaxis(texcoords[faces].astype(np.float64), 1, 0)[[1, 2]]
    origin = texcoords[faces[:, 0]].astype(np.float64)
    (s1, t1), (s2, t2) = (first - origin).T, (second - origin).T
    turn = s1 * t2 - s2 * t1
    edges = places[:, [1, 2, 0]] - places
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along = edges[:, 0] * t2[:, None] + edges[:, 2] * t1[:, None]
        along *= (np.sign(turn) / np.linalg.norm(along, axis=1))[:, None]
        edges /= np.linalg.norm(edges, axis=2)[:, :, None]
    for k in range(3):
        cosines = -np.einsum("ij,ij->i", edges[:, k], edges[:, k - 1])
        shares = along * np.arccos(np.clip(cosines, -1.0, 1.0))[:, None]
        is_sound = np.isfinite(shares).all(axis=1)
        np.add.at(
            sums, ((turn[is_sound] < 0.0).astype(np.intp), faces[is_sound, k]), shares[is_sound]
        )
    lengths = np.linalg.norm(sums, axis=2, keepdims=True)
    return np.divide(sums, lengths, out=sums, where=lengths > 0.0).astype(np.float32)
