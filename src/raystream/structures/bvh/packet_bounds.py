"""What all rays of a pass of a packet have in common: the interval ray."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    f32x8,
    f32x16,
    fma,
    i32x16,
    load,
    maximum,
    minimum,
    reduce_max,
    reduce_min,
    select,
)
from raystream.kernels.ray import PAD
from raystream.structures.bvh.packet_rays import ARRAY, CLASS, GROUP, GROUPS, INV, ORIGIN
from raystream.structures.bvh.wide import BOX_FLIP, NODE_AXIS

__all__ = ["Bounds", "enters", "packet_bounds"]

_ZERO = np.float32(0.0)
_TWO = np.float32(2.0)
_INF = np.float32(np.inf)
_U0 = np.uint64(0)
_U1 = np.uint64(1)
_U2 = np.uint64(2)


class Bounds(NamedTuple):
    """What all rays of a pass have in common, for each axis.

    Attributes
    ----------
    near_at, far_at : uint64
        Where in a node the near and far planes are.
    low, high : float32
        Of the reciprocal directions.
    near_low, near_high, far_low, far_high : float32
        Slab constants that go with them.
    back : bool
        The rays go towards lower coordinates.
    """

    near_at: np.uint64
    far_at: np.uint64
    low: np.float32
    high: np.float32
    near_low: np.float32
    near_high: np.float32
    far_low: np.float32
    far_high: np.float32
    back: bool


@device
def _extremes(packet, kind, axis):
    """Bounds of the rays of a kind along an axis."""
    offset = axis * ARRAY
    least_inv, most_inv = f32x16(_INF), f32x16(-_INF)
    least_o, most_o = f32x16(_INF), f32x16(-_INF)
    for g in range(GROUPS):
        at = packet + g * GROUP
        mine = load(i32x16, at + CLASS) == kind
        inv = load(f32x16, at + INV + offset)
        o = load(f32x16, at + ORIGIN + offset)
        least_inv = select(mine, minimum(inv, least_inv), least_inv)
        most_inv = select(mine, maximum(inv, most_inv), most_inv)
        least_o = select(mine, minimum(o, least_o), least_o)
        most_o = select(mine, maximum(o, most_o), most_o)
    low, high = reduce_min(least_inv), reduce_max(most_inv)
    origin_low, origin_high = reduce_min(least_o), reduce_max(most_o)
    return low, high, origin_low, origin_high


@device
def _slab_bounds(axis, low, high, origin_low, origin_high, pad):
    """The interval ray's constants; its padding is twice the rays', for its own rounding."""
    near_at = axis * NODE_AXIS
    back = high < _ZERO
    if back:
        near_at += BOX_FLIP
        from_near, from_far = origin_low - pad, origin_high + pad
    else:
        from_near, from_far = origin_high + pad, origin_low - pad
    return Bounds(
        near_at,
        near_at ^ BOX_FLIP,
        low,
        high,
        -(from_near * low),
        -(from_near * high),
        -(from_far * low),
        -(from_far * high),
        back,
    )


@device
def _near_of(node, b):
    planes = load(f32x8, node + b.near_at)
    return minimum(fma(planes, b.low, b.near_low), fma(planes, b.high, b.near_high))


@device
def _far_of(node, b):
    planes = load(f32x8, node + b.far_at)
    return maximum(fma(planes, b.low, b.far_low), fma(planes, b.high, b.far_high))


@device
def packet_bounds(packet, kind, extreme):
    """Bounds of the rays of a kind, for each axis."""
    lx, hx, olx, ohx = _extremes(packet, kind, _U0)
    ly, hy, oly, ohy = _extremes(packet, kind, _U1)
    lz, hz, olz, ohz = _extremes(packet, kind, _U2)
    reach = max(abs(olx), abs(ohx), abs(oly), abs(ohy), abs(olz), abs(ohz))
    pad = _TWO * PAD * (extreme + reach)
    return (
        _slab_bounds(_U0, lx, hx, olx, ohx, pad),
        _slab_bounds(_U1, ly, hy, oly, ohy, pad),
        _slab_bounds(_U2, lz, hz, olz, ohz, pad),
    )


@device
def enters(node, x, y, z, t_min, t_max):
    """Test a node's eight boxes against the interval ray.

    Returns
    -------
    t_in : f32x8
        At least so far away each box is entered.
    mask : mask8
        The boxes that some ray may enter between `t_min` and `t_max`.
    """
    t_in = maximum(maximum(_near_of(node, x), _near_of(node, y)), _near_of(node, z))
    t_out = minimum(minimum(_far_of(node, x), _far_of(node, y)), _far_of(node, z))
    return t_in, maximum(t_in, t_min) <= minimum(t_out, t_max)
