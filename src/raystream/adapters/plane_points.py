"""Points where rays meet the planes of the triangles that they hit, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["in_planes"]

#: Part of the scene's size by which a hit's position may be off: its weights and the vertices
#: are float32.
_ROUNDING = 2.0**-18


def in_planes(
    positions: NDArray[np.float64],
    rays: tuple[NDArray[Any], NDArray[Any]],
    corners: NDArray[Any],
    size: float,
) -> NDArray[np.float64]:
    """Refine positions of hits from float32 to float64.

    Parameters
    ----------
    positions : ndarray of shape (K, 3), float64
        `Hits.positions`.
    rays : two ndarray of shape (K, 3), real
        Origins and directions.
    corners : ndarray of shape (K, 3, 3), real
        Vertices of the triangles, world space.
    size : float
        Largest distance from the scene's centre, along an axis.

    Returns
    -------
    ndarray of shape (K, 3), float64
        The points where the rays meet the planes; `positions` where that point is farther away
        than rounding explains, as for a ray almost in the plane.
    """
    origins, directions = (np.asarray(part, np.float64) for part in rays)
    corners = corners.astype(np.float64)
    first = corners[:, 0]
    normals = np.cross(corners[:, 1] - first, corners[:, 2] - first)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        along = directions / np.abs(directions).max(axis=1, keepdims=True, initial=0.0)
        # From the point of the ray nearest to the position, so that little is left to cancel.
        nearest = origins + along * (_dot(positions - origins, along) / _dot(along, along))
        points: NDArray[np.float64] = nearest + along * (
            _dot(first - nearest, normals) / _dot(along, normals)
        )
        is_close = np.linalg.norm(points - positions, axis=1) <= _ROUNDING * size
    return np.where(is_close[:, None], points, positions)


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    product: NDArray[np.float64] = np.einsum("ij,ij->i", a, b)[:, None]
    return product
