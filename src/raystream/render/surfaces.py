"""Surfaces: attributes of the triangles at the points that rays hit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
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
        self._normals = _joined([mesh.normals for mesh in scene.meshes], scene, 3, np.nan)
        self._colors = _joined([mesh.colors for mesh in scene.meshes], scene, 3, 1.0)
        self._texcoords = _joined([mesh.texcoords for mesh in scene.meshes], scene, 2, np.nan)
        self._faces = np.empty((0, 3), np.int64)
        if not (self._normals is None and self._colors is None and self._texcoords is None):
            counts = [len(mesh.vertices) for mesh in scene.meshes]
            firsts = np.cumsum([0, *counts[:-1]])
            faces = [m.faces + first for m, first in zip(scene.meshes, firsts, strict=True)]
            self._faces = np.concatenate(faces)
        ids = [mesh.material_ids for mesh in scene.meshes]
        self._material_ids = np.concatenate(ids) if ids else np.empty(0, np.int32)

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
        if self._normals is not None:
            normals = _turned(self._interpolate(self._normals, hits), facing)
        if self._colors is not None:
            colors = self._interpolate(self._colors, hits)
        if self._texcoords is not None:
            texcoords = self._interpolate(self._texcoords, hits)
        return SurfacePoints(
            hits.positions,
            normals,
            front,
            self._material_ids[hits.prim_id],
            colors,
            texcoords,
        )

    def _interpolate(self, values: NDArray[np.float32], hits: Hits) -> NDArray[np.float32]:
        corners = values[self._faces[hits.prim_id]]
        u, v = hits.u[:, None], hits.v[:, None]
        result: NDArray[np.float32] = (
            (1.0 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        )
        return result


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


def _turned(smooth: NDArray[np.float32], facing: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit shading normals on the side of `facing`, and `facing` itself where there are none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        smooth = smooth / np.linalg.norm(smooth, axis=1, keepdims=True)
    usable: NDArray[np.bool_] = np.all(np.isfinite(smooth), axis=1)
    smooth = np.where(usable[:, None], smooth, facing)
    opposite = np.einsum("nk,nk->n", smooth, facing) < 0.0
    result: NDArray[np.float32] = np.where(opposite[:, None], -smooth, smooth)
    return result
