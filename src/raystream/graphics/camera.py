"""A pinhole camera as a uniform of shaders."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.scene.camera import Camera

#: Depth of the near plane, in sizes of the scene: reversed float depth has the same relative
#: precision everywhere.
_NEAR = 2.0**-24


def check_pinhole(camera: Camera) -> None:
    """Raise ValueError for a camera that is not a perspective one."""
    if camera.projection != "perspective":
        raise ValueError(
            f"camera: the graphics pipeline supports only 'perspective', got {camera.projection!r}"
        )


def packed_view(camera: Camera, size: tuple[int, int], triangles: Triangles) -> bytes:
    """The uniform ``View``, see ``camera.wgsl``: float64 numbers as sums of two float32.

    Parameters
    ----------
    camera : Camera
        Perspective; a lens is taken as a pinhole.
    size : (int, int)
        Width and height in pixels.
    triangles : Triangles
        The scene's: they define the local frame.
    """
    width, height = size
    right, up, forward = map(_halves, camera.basis())
    scale = _halves(2.0 * math.tan(math.radians(camera.fov) / 2.0) / height)
    eye = ((np.array(camera.eye) - triangles.center) * triangles.scale).astype(np.float32)
    near = max(float(triangles.max_coordinate), float(np.abs(eye).max()), 1e-30) * _NEAR
    rows = [
        [*eye, near],
        [*right[0], scale[0]],
        [*right[1], scale[1]],
        [*up[0], width],
        [*up[1], height],
        [*forward[0], 1.0 / triangles.scale],
        [*forward[1], 0.0],
    ]
    return np.array(rows, np.float32).tobytes()


def _halves(value: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """A float64 number or vector as the sum of two of float32."""
    exact = np.asarray(value, np.float64)
    high = exact.astype(np.float32)
    return high, (exact - high).astype(np.float32)
