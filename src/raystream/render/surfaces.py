"""Surfaces: attributes of the triangles at the points that rays hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.render.attributes import VertexAttributes, material_ids_of
from raystream.scene.scene import Scene

__all__ = ["SurfacePoints", "Surfaces"]


@dataclass(frozen=True)
class SurfacePoints:
    """Points on surfaces, one for each of N hits.

    Attributes
    ----------
    positions : ndarray of shape (N, 3), float64
        World space.
    normals : ndarray of shape (N, 3), float32
        Unit shading normals, on the side that the ray came from.
    front : ndarray of shape (N,), bool
        Whether the ray came from the side where vertices run counter-clockwise.
    material_ids : ndarray of shape (N,), int32
    colors : ndarray of shape (N, 3), float32
        Linear RGB of the vertices; 1 where a mesh has none.
    texcoords : ndarray of shape (N, 2), float32, or None
        NaN where a mesh has none; None if no mesh has any.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float32]
    front: NDArray[np.bool_]
    material_ids: NDArray[np.int32]
    colors: NDArray[np.float32]
    texcoords: NDArray[np.float32] | None


class Surfaces:
    """Vertex attributes of a whole scene, by prim_id.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene) -> None:
        self._vertices = VertexAttributes.of(scene)
        self._material_ids = material_ids_of(scene)

    def at(self, hits: Hits, directions: NDArray[np.float32]) -> SurfacePoints:
        """Look up the attributes where rays hit.

        Parameters
        ----------
        hits : Hits of shape (N,)
            All of them hits.
        directions : ndarray of shape (N, 3)
            Of the rays.
        """
        plane_normals = hits.normals
        front: NDArray[np.bool_] = np.einsum("nk,nk->n", plane_normals, directions) <= 0.0
        facing = np.where(front[:, None], plane_normals, -plane_normals)
        normals, colors, texcoords = facing, np.ones_like(facing), None
        vertices = self._vertices
        if vertices.normals is not None:
            normals = _turned(self._interpolate(vertices.normals, hits), facing)
        if vertices.colors is not None:
            colors = self._interpolate(vertices.colors, hits)
        if vertices.texcoords is not None:
            texcoords = self._interpolate(vertices.texcoords, hits)
        return SurfacePoints(
            hits.positions,
            normals,
            front,
            self._material_ids[hits.prim_id],
            colors,
            texcoords,
        )

    def _interpolate(self, values: NDArray[np.float32], hits: Hits) -> NDArray[np.float32]:
        corners = values[self._vertices.faces[hits.prim_id]]
        u, v = hits.u[:, None], hits.v[:, None]
        result: NDArray[np.float32] = (
            (1.0 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        )
        return result


def _turned(smooth: NDArray[np.float32], facing: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit shading normals on the side of `facing`, and `facing` itself where there are none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = smooth / np.linalg.norm(smooth, axis=1, keepdims=True)
    usable: NDArray[np.bool_] = np.all(np.isfinite(smooth), axis=1)
    smooth = np.where(usable[:, None], smooth, facing)
    opposite = np.einsum("nk,nk->n", smooth, facing) < 0.0
    result: NDArray[np.float32] = np.where(opposite[:, None], -smooth, smooth)
    return result
