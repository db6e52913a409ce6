"""The slab test: the part of a ray inside an axis-aligned box."""

from __future__ import annotations

from raystream.jit.constants import ZERO_F32
from raystream.jit.cpu import device
from raystream.jit.simd import fma


@device
def box_interval(ray, low_x, low_y, low_z, high_x, high_y, high_z):
    """Distances at which a ray enters and leaves a box that is grown by the ray's padding.

    Each distance is one fused multiply-add of a plane, which rounds once and so is
    monotone in the plane: a box inside another one has an interval inside the other's, bit for
    bit. Traversal depends on that, so every structure uses this function and no other.

    Parameters
    ----------
    ray : Ray
    low_x, low_y, low_z, high_x, high_y, high_z : float32
        Corners of the box, local frame.

    Returns
    -------
    t_in, t_out : float32
        The ray is inside for t_in <= t <= t_out; it misses the box if t_in > t_out.
    """
    if ray.inv_x < ZERO_F32:
        low_x, high_x = high_x, low_x
    if ray.inv_y < ZERO_F32:
        low_y, high_y = high_y, low_y
    if ray.inv_z < ZERO_F32:
        low_z, high_z = high_z, low_z
    t_in = max(
        fma(low_x, ray.inv_x, ray.near_x),
        fma(low_y, ray.inv_y, ray.near_y),
        fma(low_z, ray.inv_z, ray.near_z),
    )
    t_out = min(
        fma(high_x, ray.inv_x, ray.far_x),
        fma(high_y, ray.inv_y, ray.far_y),
        fma(high_z, ray.inv_z, ray.far_z),
    )
    return t_in, t_out
