"""Planes of triangles: where rays meet them, and their normals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Part of the scene's size by which a hit may be off: its weights and the vertices are float32.
_ROUNDING = 2.0**-18

#: Triangles whose normals are computed at a time.
_BLOCK = 1 << 18


def plane_points(
    corners: NDArray[Any],
    weights: tuple[NDArray[np.float32], NDArray[np.float32]],
    rays: tuple[NDArray[Any], NDArray[Any]],
    size: float,
) -> NDArray[np.float64]:
    """Compute the positions of hits in float64.

    Parameters
    ----------
    corners : ndarray of shape (K, 3, 3), real
        Vertices of the triangles, world space.
    weights : two ndarray of shape (K,), float32
        Of vertices 1 and 2.
    rays : two ndarray of shape (K, 3), real
        Origins and directions.
    size : float
        Largest distance of a vertex from the scene's centre, along an axis.

    Returns
    -------
    ndarray of shape (K, 3), float64
        The points where the rays meet the planes; the point of the triangle that has these weights
        where that is farther away than rounding explains, as for a ray almost in the plane.
    """
    # By components, which NumPy adds up faster than rows of three.
    first, second, third = np.moveaxis(corners, 0, -1).astype(np.float64, order="C")
    origins, along = (np.asarray(part.T, np.float64, order="C") for part in rays)
    to_second, to_third = second - first, third - first
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        on_triangle = first + weights[0] * to_second + weights[1] * to_third
        normals = _cross(to_second, to_third)
        along = along / np.abs(along).max(axis=0)
        # From the point of the ray nearest to the triangle's, so that little is left to cancel.
        nearest = origins + along * (_dot(on_triangle - origins, along) / _dot(along, along))
        points = nearest + along * (_dot(first - nearest, normals) / _dot(along, normals))
        off = points - on_triangle
        is_close = _dot(off, off) <= (_ROUNDING * size) ** 2
    return np.ascontiguousarray(np.where(is_close, points, on_triangle).T)


def unit_normals(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Unit normals of triangles, and a last row of zeros.

    Parameters
    ----------
    corners : ndarray of shape (F, 3, 3), float32

    Returns
    -------
    ndarray of shape (F + 1, 3), float32
        Zeros, too, for triangles without area or with a vertex that is not finite.
    """
    normals = np.zeros((len(corners) + 1, 3), np.float32)
    for start in range(0, len(corners), _BLOCK):
        block = corners[start : start + _BLOCK]
        first, second, third = np.moveaxis(block, 0, -1).astype(np.float64, order="C")
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            across = _cross(second - first, third - first)
            # Scaled before it is measured: the square of a small area would vanish.
            across /= np.abs(across).max(axis=0)
            across /= np.sqrt(_dot(across, across))
        normals[start : start + len(block)] = np.nan_to_num(across.T)
    return normals


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
