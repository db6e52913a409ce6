"""Rays and hits as shaders store them, to and from the arrays of a query."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.hits import HitArrays
from raystream.kernels.local_frame import LocalRays
from raystream.machines.ray_block import RayBlock

#: In place of infinity, which WGSL does not guarantee; see ray.wgsl.
FAR = np.finfo(np.float32).max

#: Most hits of a ray that can be counted, besides the codes of `termination`.
MOST_HITS = 2**32 - 4


class RayKind(NamedTuple):
    """How a machine of the device stores rays.

    Attributes
    ----------
    block : callable
        Makes a block of rays, as `machines.ray_block.RayBlock`.
    packed : callable
        ``packed(rays, rows)``: some rays of a block as shaders read them, shape (N, k, 4), float32.
    own_bytes : int
        Bytes of a ray besides those of a `LocalRays`.
    """

    block: Callable[..., RayBlock]
    packed: Callable[..., NDArray[np.float32]]
    own_bytes: int


#: A hit.
ROW = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("prim_id", "i4")])


def packed_rays(rays: LocalRays, rows: slice) -> NDArray[np.float32]:
    """Origin and t_min, direction and t_max of some rays: shape (N, 2, 4), float32, finite.

    A ray with an empty interval, and an invalid one, gets t_min = 1, t_max = 0, and a direction.
    """
    packed = np.empty((rows.stop - rows.start, 2, 4), np.float32)
    packed[:, 0, :3], packed[:, 1, :3] = rays.origins[rows], rays.directions[rows]
    packed[:, 0, 3] = np.clip(rays.t_min[rows], -FAR, FAR)
    packed[:, 1, 3] = np.clip(rays.t_max[rows], -FAR, FAR)
    # In this form, NaN is inactive.
    is_active = (rays.t_min[rows] <= rays.t_max[rows]) & np.isfinite(packed).all(axis=(1, 2))
    packed[~is_active] = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]]
    return packed


def unpack_rows(rows: NDArray[Any], out: HitArrays) -> None:
    """Copy hits to columns; a miss gets t = inf."""
    out.t[:], out.u[:], out.v[:], out.prim_id[:] = (rows[name] for name in ROW.names or ())
    out.t[rows["prim_id"] < 0] = np.inf


#: Rays in the scene's local frame.
LOCAL_RAYS = RayKind(RayBlock, packed_rays, 0)
