"""Distances of split planes along a ray, and the part of a ray in the scene's box.

A plane has one distance along a ray, ``fma(plane, inv, middle)``: the slab distance without
padding. It depends on the plane's position alone and is monotone in it, so the cells of a kd-tree,
of a graph and of a grid divide a ray into half-open parts, and each t belongs to exactly one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ZERO_F32
from raystream.jit.cpu import device
from raystream.jit.simd import fma
from raystream.kernels.ray import component
from raystream.kernels.slab import box_interval

_HALF = np.float32(0.5)


class SplitRay(NamedTuple):
    """A ray as the steps use it: the constants of its distances to split planes.

    Attributes
    ----------
    inv_x, inv_y, inv_z, middle_x, middle_y, middle_z : float32
    """

    inv_x: np.float32
    inv_y: np.float32
    inv_z: np.float32
    middle_x: np.float32
    middle_y: np.float32
    middle_z: np.float32


@device
def split_ray(ray):
    """A `kernels.ray.Ray` as a `SplitRay`.

    ``middle`` is the mean of the slab constants of both paddings: that of an unpadded plane, to
    within two roundings.
    """
    return SplitRay(
        ray.inv_x,
        ray.inv_y,
        ray.inv_z,
        (ray.near_x + ray.far_x) * _HALF,
        (ray.near_y + ray.far_y) * _HALF,
        (ray.near_z + ray.far_z) * _HALF,
    )


@device
def plane_distance(line, axis, position):
    """Distance of a plane along a ray, and whether the ray crosses it upward."""
    inv = component(axis, line.inv_x, line.inv_y, line.inv_z)
    middle = component(axis, line.middle_x, line.middle_y, line.middle_z)
    return fma(position, inv, middle), inv > ZERO_F32


@device
def scene_interval(tree, ray, t_min, t_max):
    """The part of a ray's interval in the scene's box; empty if t_in > t_out.

    A hit lies in its triangle's slab interval, so in that of the box.

    Parameters
    ----------
    tree : NamedTuple
        With `low` and `high`, triples of float32.
    ray : Ray
    t_min, t_max : float32

    Returns
    -------
    t_in, t_out : float32
    """
    low, high = tree.low, tree.high
    t_in, t_out = box_interval(ray, low[0], low[1], low[2], high[0], high[1], high[2])
    return max(t_in, t_min), min(t_out, t_max)
