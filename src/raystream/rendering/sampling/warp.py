"""Warps of the unit square to disks, triangles and directions.

All take two float32 numbers u and v in [0, 1), such as those of `draw_pair`, and have low
distortion, to preserve stratification. Directions are around +z and of unit length; `basis` and
`to_world` rotate them.
Vectors of float32 work as well as float32, with the same bits in each lane.
"""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    copy_sign,
    exponential,
    logarithm,
    maximum,
    select,
    sincos_turns,
    square_root,
)

_0, _HALF, _1, _2 = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_EIGHTH, _QUARTER = np.float32(0.125), np.float32(0.25)
_SIXTH, _24TH, _120TH = np.float32(1 / 6), np.float32(1 / 24), np.float32(1 / 120)
_INV_PI, _INV_TWO_PI = np.float32(1 / math.pi), np.float32(0.5 / math.pi)
_INV_FOUR_PI = np.float32(0.25 / math.pi)


@device
def disk(u, v):
    """A uniform point of the unit disk, by a concentric map.

    Returns
    -------
    x, y : float32

    References
    ----------
    .. [1] Shirley and Chiu, "A Low Distortion Map Between Disk and Square", Journal of
       Graphics Tools 2(3), 1997.
    """
    a, b = _2 * u - _1, _2 * v - _1
    is_wide = absolute(a) > absolute(b)
    radius, rest = select(is_wide, a, b), select(is_wide, b, a)
    part = _EIGHTH * (rest / select(radius == _0, _1, radius))
    x, y = sincos_turns(select(is_wide, part, _QUARTER - part))
    return radius * x, radius * y


@device
def cosine_hemisphere(u, v):
    """A direction with density proportional to its cosine to +z.

    Returns
    -------
    x, y, z : float32
        z is the cosine, at least 0. The projection is a uniform disk (Malley).
    """
    x, y = disk(u, v)
    return x, y, square_root(maximum(_1 - x * x - y * y, _0))


@device
def _around(z, radius, v):
    """The direction with this z, at azimuth v * 2 pi."""
    x, y = sincos_turns(v)
    return radius * x, radius * y, z


@device
def sphere(u, v):
    """A uniform direction: x, y, z of float32."""
    # The radius from u, not from 1 - z * z, which cancels for small ones.
    return _around(_1 - _2 * u, _2 * square_root(u * (_1 - u)), v)


@device
def _missing(x):
    """1 - exp(x) for x <= 0, accurate near 0 (Taylor series)."""
    series = -x * (_1 + x * (_HALF + x * (_SIXTH + x * (_24TH + x * _120TH))))
    return select(x > -_QUARTER, series, _1 - exponential(x))


@device
def power_cosine(u, v, exponent):
    """A direction with density proportional to a power of its cosine to +z: Phong's lobe.

    Parameters
    ----------
    u, v : float32
    exponent : float32
        At least 0.

    Returns
    -------
    x, y, z : float32
        z is the cosine, at least 0.
    """
    # u has 24 bits: 1 - u is exact, and at least 2**-24.
    height = logarithm(_1 - u) / (exponent + _1)
    return _around(exponential(height), square_root(_missing(_2 * height)), v)


@device
def triangle(u, v):
    """A uniform point of a triangle, by folding the square along its diagonal.

    Returns
    -------
    b1, b2 : float32
        Barycentric weights of vertices 1 and 2; vertex 0 has 1 - b1 - b2. None is negative.

    References
    ----------
    .. [1] Heitz, "A Low-Distortion Map Between Triangle and Square", 2019.
    """
    half = _HALF * select(v > u, u, v)
    return select(v > u, half, u - half), select(v > u, v - half, half)


@device
def basis(x, y, z):
    """Tangent and bitangent of a unit normal: a right-handed frame.

    Parameters
    ----------
    x, y, z : float32
        The normal, of unit length.

    Returns
    -------
    tx, ty, tz, bx, by, bz : float32
        Tangent and bitangent: their cross product is the normal. They are continuous in the
        normal, except where its z changes sign.

    References
    ----------
    .. [1] Duff et al., "Building an Orthonormal Basis, Revisited", Journal of Computer
       Graphics Techniques 6(1), 2017.
    """
    side = copy_sign(select(z == z, _1, z), z)
    a = -_1 / (side + z)
    b = x * y * a
    return _1 + side * x * x * a, side * b, -side * x, b, side + y * y * a, -y


@device
def to_world(x, y, z, nx, ny, nz):
    """Rotate a direction around +z to one around a unit normal.

    Parameters
    ----------
    x, y, z, nx, ny, nz : float32
        The direction, and the normal.

    Returns
    -------
    x, y, z : float32
    """
    tx, ty, tz, bx, by, bz = basis(nx, ny, nz)
    return x * tx + y * bx + z * nx, x * ty + y * by + z * ny, x * tz + y * bz + z * nz
