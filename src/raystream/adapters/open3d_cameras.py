"""Rays of a pinhole camera, as Open3D makes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.adapters.open3d_arrays import host_array
from raystream.core.rays import as_real_array


def pinhole_rays(
    intrinsic_matrix: Any, extrinsic_matrix: Any, width_px: int, height_px: int
) -> NDArray[np.float32]:
    """Rays through the centres of pixels, shape (height_px, width_px, 6), float32.

    Directions have length 1 along the camera's axis.
    """
    intrinsic = _matrix("intrinsic_matrix", intrinsic_matrix, (3, 3))
    extrinsic = _matrix("extrinsic_matrix", extrinsic_matrix, (4, 4))
    rotation = extrinsic[:3, :3]
    if np.linalg.det(intrinsic) == 0.0:
        raise ValueError("intrinsic_matrix: singular; focal lengths must not be 0")
    x, y = np.arange(width_px) + 0.5, np.arange(height_px) + 0.5
    pixels = np.empty((height_px, width_px, 3))
    pixels[..., 0], pixels[..., 1], pixels[..., 2] = x, y[:, None], 1.0
    rays = np.empty((height_px, width_px, 6), np.float32)
    rays[..., :3] = -rotation.T @ extrinsic[:3, 3]
    rays[..., 3:] = pixels @ (rotation.T @ np.linalg.inv(intrinsic)).T
    return rays


def matrices_of_view(
    fov_deg: float, view: tuple[Any, Any, Any], size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The intrinsic and extrinsic matrix of a camera at `eye` that looks at `center`.

    Parameters
    ----------
    fov_deg : float
        Horizontal, in degrees.
    view : tuple of three array_like of shape (3,)
        Center, eye and up.
    size : tuple of two int
        Width and height in pixels.
    """
    if not 0.0 < fov_deg < 180.0:
        raise ValueError(f"fov_deg: expected more than 0 and less than 180, got {fov_deg}")
    center, eye, up = (
        _matrix(name, value, (3,))
        for name, value in zip(("center", "eye", "up"), view, strict=True)
    )
    forward, across = center - eye, np.cross(up, center - eye)
    if not forward.any():
        raise ValueError("center, eye: expected different points")
    if not across.any():
        raise ValueError("up: parallel to the direction of view, or zero")
    forward, across = forward / np.linalg.norm(forward), across / np.linalg.norm(across)
    width, height = size
    focal_length = 0.5 * width / math.tan(math.radians(fov_deg) / 2)
    intrinsic = np.array(
        [[focal_length, 0.0, width / 2], [0.0, focal_length, height / 2], [0.0, 0.0, 1.0]]
    )
    extrinsic = np.eye(4)
    extrinsic[:3, :3] = across, np.cross(forward, across), forward
    extrinsic[:3, 3] = -extrinsic[:3, :3] @ eye
    return intrinsic, extrinsic


def _matrix(name: str, values: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    array = as_real_array(name, host_array(name, values)).astype(np.float64)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {array.tolist()}")
    return array
