"""The outline of a model: the points that decide how far away a camera must be."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raystream.scene.default_view.sizes import Mask, TriangleSizes

#: Widths of images over their heights; between two of them, the outline hardly differs.
_ASPECTS = 2.0 ** np.arange(-2.5, 2.6, 0.25)

#: Triangles handled at once.
_BLOCK = 1 << 14


def outline_points(
    sizes: TriangleSizes,
    bulk: Mask,
    box: NDArray[np.float32],
    toward_eye: NDArray[np.float64],
    up: NDArray[np.float64],
    fov: float,
) -> NDArray[np.float64]:
    """Find the points of a model that touch the borders of images in which it is whole.

    Parameters
    ----------
    sizes : TriangleSizes
    bulk, box
        See `find_bulk`; what is outside the box does not count.
    toward_eye, up : ndarray of shape (3,), float64
        Unit vectors: from the model to the camera, and the world's up.
    fov : float
        The camera's vertical field of view in degrees.

    Returns
    -------
    ndarray of shape (K, 3), float64
        Local frame: corners of triangles' boxes. K is 0 without triangles in the box.
    """
    right = np.cross(up, toward_eye)
    right /= np.linalg.norm(right)
    upward = np.cross(toward_eye, right)
    slopes = 1.0 / math.tan(math.radians(fov) / 2.0)
    sides = [upward * slopes, *(right * (slopes / aspect) for aspect in _ASPECTS)]
    # Normals of the planes through the borders: the farthest point along each touches it.
    normals = np.array([toward_eye + sign * side for side in sides for sign in (1.0, -1.0)])
    wide = normals.astype(np.float32)
    best, points = np.full(len(normals), -np.inf, np.float32), np.zeros((len(normals), 3))
    for first in range(0, len(sizes.areas), _BLOCK):
        rows = slice(first, first + _BLOCK)
        kept = slice(None) if bulk is None else bulk[rows]
        low = np.maximum(sizes.low[:, rows][:, kept], box[0][:, None])
        high = np.minimum(sizes.high[:, rows][:, kept], box[1][:, None])
        is_inside = (low <= high).all(axis=0)
        low, high = low[:, is_inside], high[:, is_inside]
        if not low.size:
            continue
        reach = wide @ (0.5 * (low + high)) + np.abs(wide) @ (0.5 * (high - low))
        farthest = reach.argmax(axis=1)
        values = reach[np.arange(len(normals)), farthest]
        for k in np.flatnonzero(values > best):
            at = farthest[k]
            points[k] = np.where(normals[k] > 0.0, high[:, at], low[:, at])
        best = np.maximum(best, values)
    return points[best > -np.inf]
