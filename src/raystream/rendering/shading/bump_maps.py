"""Bump maps: slopes of bilinear heights, by differences over two texels.

Heights one texel away have the same bilinear weights, so that the four heights around a point
need twelve texels in total; each is fetched once.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import absolute, any_lane, as_int32, gather, maximum, minimum, select
from raystream.rendering.shading.textures import (
    CLAMPED_U,
    CLAMPED_V,
    MIRRORED_U,
    MIRRORED_V,
    nearest_texels,
    wrapped,
)

_0, _1, _2, _BEFORE = (np.int32(k) for k in (0, 1, 2, -1))
_NULL, _HALF, _WHOLE, _INF = map(np.float32, (0.0, 0.5, 1.0, np.inf))


@device
def _four(index, size, is_clamped, is_mirrored):
    """The texels at an index minus 1 and plus 0, 1 and 2."""
    here = wrapped(index, size, is_clamped)
    last = as_int32(size - _1)
    before = wrapped(as_int32(here - _1), size, is_clamped)
    after = wrapped(as_int32(here + _1), size, is_clamped)
    behind = wrapped(as_int32(after + _1), size, is_clamped)
    # Neighbours of an index outside a clamped texture may be outside, too.
    return (
        select(is_clamped, _within(as_int32(index - _1), last, is_mirrored), before),
        here,
        select(is_clamped, _within(as_int32(index + _1), last, is_mirrored), after),
        select(is_clamped, _within(as_int32(index + _2), last, is_mirrored), behind),
    )


@device
def _within(index, last, is_mirrored):
    if any_lane(is_mirrored):
        # The first texel's neighbour is itself, and then the second one.
        past = select(index > last, as_int32(last + last + _1 - index), index)
        index = select(is_mirrored, select(index < _0, as_int32(_BEFORE - index), past), index)
    return minimum(maximum(index, _0), last)


@device
def _between(a, b, share):
    return a * (_WHOLE - share) + b * share


@device
def _height(tables, first, width, column, row):
    return gather(np.float32, tables.texels, as_int32(first + row * width + column))


@device_call
def bump_slopes(tables, texture, u, v):
    """Central differences of a bump map along u and v, negated.

    Parameters
    ----------
    tables : TextureTables
    texture : int32, or i32x16
        Its row of `places`: a texture of heights.
    u, v : float64, or f32x16
        Texture coordinates; v points up.

    Returns
    -------
    tuple of two float32, or f32x16
        0 where u or v is not finite.
    """
    is_known = (absolute(u) < _INF) & (absolute(v) < _INF)
    first, width, height, bits, left, top, across, down, slopes = nearest_texels(
        tables, texture, select(is_known, u, _HALF), select(is_known, v, _HALF), _WHOLE
    )
    is_clamped_u, is_clamped_v = (bits & CLAMPED_U) != _0, (bits & CLAMPED_V) != _0
    is_mirrored_u, is_mirrored_v = (bits & MIRRORED_U) != _0, (bits & MIRRORED_V) != _0
    x0, x1, x2, x3 = _four(left, width, is_clamped_u, is_mirrored_u)
    y0, y1, y2, y3 = _four(top, height, is_clamped_v, is_mirrored_v)
    a1 = _height(tables, first, width, x1, y0)
    a2 = _height(tables, first, width, x2, y0)
    b0 = _height(tables, first, width, x0, y1)
    b1 = _height(tables, first, width, x1, y1)
    b2 = _height(tables, first, width, x2, y1)
    b3 = _height(tables, first, width, x3, y1)
    c0 = _height(tables, first, width, x0, y2)
    c1 = _height(tables, first, width, x1, y2)
    c2 = _height(tables, first, width, x2, y2)
    c3 = _height(tables, first, width, x3, y2)
    d1 = _height(tables, first, width, x1, y3)
    d2 = _height(tables, first, width, x2, y3)
    upper = _between(b0, b1, across) - _between(b2, b3, across)
    lower = _between(c0, c1, across) - _between(c2, c3, across)
    at_left = _between(c1, d1, down) - _between(a1, b1, down)
    at_right = _between(c2, d2, down) - _between(a2, b2, down)
    return (
        select(is_known, slopes[0] * _between(upper, lower, down), _NULL),
        select(is_known, slopes[1] * _between(at_left, at_right, across), _NULL),
    )
