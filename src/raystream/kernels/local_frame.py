"""Batches of rays: to a scene's local frame, and their hits' distances back to world space."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import kernel
from raystream.kernels.ray import world_t
from raystream.kernels.ray_source import load_ray


class LocalRays(NamedTuple):
    """Rays in the local frame of a scene, ready to trace.

    Attributes
    ----------
    origins, directions : ndarray of shape (N, 3), float32
        The largest component of each direction is in [1, 2).
    t_min, t_max : ndarray of shape (N,), float32
        Closed interval in local direction lengths; empty for a ray that cannot hit.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_min: NDArray[np.float32]
    t_max: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> LocalRays:
        """Uninitialised arrays for `count` rays."""
        origins, directions = (np.empty((count, 3), np.float32) for _ in range(2))
        return cls(origins, directions, np.empty(count, np.float32), np.empty(count, np.float32))


class TTransform(NamedTuple):
    """Local to world distances, per ray: world t = local t * scale + offset.

    Attributes
    ----------
    scale : ndarray of shape (N,), float64
        A power of two.
    offset : ndarray of shape (N,), float64
        Zero except for origins that were advanced.
    """

    scale: NDArray[np.float64]
    offset: NDArray[np.float64]


@kernel
def to_local_rays(begin, end, source, frame, rays, to_world, status):
    """Transform rays begin to end to the local frame.

    Parameters
    ----------
    begin, end : int
    source : RaySource
    frame : SceneFrame
    rays : LocalRays
        Written. Rays that are invalid or cannot reach the scene get an empty interval.
    to_world : TTransform
        Written.
    status : ndarray of shape (N,), uint8
        Written: a `RayStatus`.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        ray = load_ray(source, i, frame)
        rays.origins[i, 0], rays.origins[i, 1], rays.origins[i, 2] = ray.origin
        directions = rays.directions
        directions[i, 0], directions[i, 1], directions[i, 2] = ray.direction
        rays.t_min[i] = ray.t_min
        rays.t_max[i] = ray.t_max
        to_world.scale[i] = ray.t_scale
        to_world.offset[i] = ray.t_offset
        status[i] = ray.status


@kernel
def to_world_t(begin, end, splits, to_world, t):
    """Convert the distances of rays begin to end to world direction lengths, in place.

    Parameters
    ----------
    begin, end : int
    splits : ndarray of shape (N + 1,), int64
        Ray i owns rows splits[i] to splits[i + 1] of `t`.
    to_world : TTransform
    t : ndarray of shape (K,), float32
        Misses (inf) stay as they are.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        for row in range(np.uint64(splits[i]), np.uint64(splits[i + np.uint64(1)])):
            if t[row] < INF_F32:
                t[row] = world_t(t[row], to_world.scale[i], to_world.offset[i])
