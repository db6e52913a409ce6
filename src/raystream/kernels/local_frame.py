"""Batches of rays into a scene's local frame, and their distances back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.kernels.local_ray import FAR, SceneFrame, to_local, world_t

__all__ = ["FAR", "LocalRays", "SceneFrame", "TScale", "to_local_rays", "to_world_t"]

_INF = np.float32(np.inf)


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
        """Make arrays for `count` rays, not initialised."""
        origins, directions = (np.empty((count, 3), np.float32) for _ in range(2))
        return cls(origins, directions, np.empty(count, np.float32), np.empty(count, np.float32))


class TScale(NamedTuple):
    """How a ray's distances go back to world space: t = local t * factor + offset.

    Attributes
    ----------
    factor : ndarray of shape (N,), float64
        A power of two.
    offset : ndarray of shape (N,), float64
        Zero but for origins that were advanced.
    """

    factor: NDArray[np.float64]
    offset: NDArray[np.float64]


@kernel
def to_local_rays(begin, end, origins, directions, t_min, t_max, frame, rays, t_scale, status):
    """Turn rays begin to end into local ones.

    Parameters
    ----------
    begin, end : int
    origins, directions : ndarray of shape (N, 3), float32 or float64
        World space.
    t_min, t_max : ndarray of shape (N,), float32
        Closed interval, in direction lengths.
    frame : SceneFrame
    rays : LocalRays
        Written. Rays that are invalid or cannot reach the scene get an empty interval.
    t_scale : TScale
        Written.
    status : ndarray of shape (N,), uint8
        Written: a `RayStatus`.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        ray = to_local(
            np.float64(origins[i, 0]),
            np.float64(origins[i, 1]),
            np.float64(origins[i, 2]),
            np.float64(directions[i, 0]),
            np.float64(directions[i, 1]),
            np.float64(directions[i, 2]),
            t_min[i],
            t_max[i],
            frame,
        )
        rays.origins[i, 0] = ray.ox
        rays.origins[i, 1] = ray.oy
        rays.origins[i, 2] = ray.oz
        rays.directions[i, 0] = ray.dx
        rays.directions[i, 1] = ray.dy
        rays.directions[i, 2] = ray.dz
        rays.t_min[i] = ray.t_min
        rays.t_max[i] = ray.t_max
        t_scale.factor[i] = ray.factor
        t_scale.offset[i] = ray.offset
        status[i] = ray.status


@kernel
def to_world_t(begin, end, splits, t_scale, t):
    """Turn the distances of rays begin to end into world direction lengths, in place.

    Parameters
    ----------
    begin, end : int
    splits : ndarray of shape (N + 1,), int64
        Ray i owns rows splits[i] to splits[i + 1] of `t`.
    t_scale : TScale
    t : ndarray of shape (K,), float32
        Misses (inf) stay as they are.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        for row in range(np.uint64(splits[i]), np.uint64(splits[i + np.uint64(1)])):
            if t[row] < _INF:
                t[row] = world_t(t[row], t_scale.factor[i], t_scale.offset[i])
