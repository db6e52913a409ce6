"""Which side of a triangle a ray crosses, and how much more often it exits than it enters."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device, kernel
from raystream.kernels.ray import prepare_ray
from raystream.kernels.ray_source import load_ray


@device
def faces_ray(ray, corners, i):
    """Whether the ray meets the front of a triangle that it crosses.

    The sign comes from the sheared corners, computed bit for bit as in `kernels.triangle`. So
    it agrees with the test that found the crossing even where rounding decides, and a ray
    through a closed mesh leaves it as often as it enters it.
    """
    a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
    az = a[ray.kz] - ray.oz
    bz = b[ray.kz] - ray.oz
    cz = c[ray.kz] - ray.oz
    ax = np.float64((a[ray.kx] - ray.ox) - ray.sx * az)
    ay = np.float64((a[ray.ky] - ray.oy) - ray.sy * az)
    bx = np.float64((b[ray.kx] - ray.ox) - ray.sx * bz)
    by = np.float64((b[ray.ky] - ray.oy) - ray.sy * bz)
    cx = np.float64((c[ray.kx] - ray.ox) - ray.sx * cz)
    cy = np.float64((c[ray.ky] - ray.oy) - ray.sy * cz)
    # If the triangle is hit, the three have the same sign or are zero.
    clockwise = (cx * by - cy * bx) + (ax * cy - ay * cx) + (bx * ay - by * ax)
    return (clockwise > 0.0) == (ray.dz > np.float32(0.0))


@kernel
def net_exits(begin, end, source, frame, corners, splits, prim_ids, exits):
    """Count how much more often rays leave a surface than they enter it.

    If t_max is infinite and the surface closed, this is the winding number of the origin.

    Parameters
    ----------
    begin, end : int
        Rays.
    source : RaySource
    frame : SceneFrame
    corners : ndarray of shape (F, 3, 3), float32
    splits : ndarray of shape (N + 1,), int64
    prim_ids : ndarray of shape (K,), int32
        The triangles that ray i crosses, from splits[i] to splits[i + 1].
    exits : ndarray of shape (N,), int64
        Written.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        local = load_ray(source, i, frame)
        ray = prepare_ray(local.origin, local.direction, frame.max_coordinate)
        total = 0
        for row in range(splits[i], splits[i + ONE_U64]):
            total += -1 if faces_ray(ray, corners, prim_ids[row]) else 1
        exits[i] = total
