"""Where points of the world are in a camera's image."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera


def seen_from(
    camera: Camera, size: tuple[int, int], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The points from which a camera sees points, and whether those are in its image.

    Parameters
    ----------
    camera : Camera
        Its lens is a pinhole.
    size : tuple of two int
        Width and height of the image, pixels.
    points : ndarray of shape (N, 3), float64
        World space.

    Returns
    -------
    origins : ndarray of shape (N, 3), float64
        The eye; of an orthographic camera points of the plane through it.
    is_inside : ndarray of shape (N,), bool
        Whether the point is in front of the camera and projected into the image, edges included.
    """
    width, height = size
    eye = np.asarray(camera.eye, np.float64)
    origins = np.broadcast_to(eye, points.shape)
    with np.errstate(invalid="ignore", over="ignore"):
        right, up, ahead = np.moveaxis((points - eye) @ camera.basis().T, -1, 0)
        if camera.projection == "equirectangular":
            finite: NDArray[np.bool_] = np.all(np.isfinite(points), axis=-1)
            return origins, finite
        if camera.projection == "orthographic":
            half = 0.5 * camera.image_height
            origins = points - ahead[:, None] * camera.basis()[2]
            is_ahead = ahead >= 0.0
        else:
            half = math.tan(math.radians(camera.fov) / 2) * ahead
            is_ahead = ahead > 0.0
        is_inside = is_ahead & (np.abs(up) <= half) & (np.abs(right) <= half * (width / height))
    return origins, is_inside
