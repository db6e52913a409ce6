"""Normals of a rough surface, after GGX, as a viewer sees them, with their density."""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import maximum, select, sincos_turns, square_root

__all__ = ["ggx_density", "visible_normal", "visible_normal_pdf"]

_0, _1, _2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_PI = np.float32(math.pi)


@device
def ggx_density(x, y, z, ax, ay):
    """Area of the surface's small faces with a normal, per area of the surface and steradian.

    Parameters
    ----------
    x, y, z : float32
        Unit normal; the surface's is +z.
    ax, ay : float32
        Roughness along x and y, above 0.

    Returns
    -------
    float32
        The integral of this times z over the hemisphere is 1; 0 below it.

    References
    ----------
    .. [1] Walter et al., "Microfacet Models for Refraction through Rough Surfaces",
       Eurographics Symposium on Rendering 2007.
    """
    sx, sy = x / ax, y / ay
    length2 = sx * sx + sy * sy + z * z
    density = _1 / (_PI * ax * ay * length2 * length2)
    return select(z > _0, density, _0 * density)


@device
def visible_normal(u, v, vx, vy, vz, ax, ay):
    """A normal of the small faces that a viewer sees, as often as its part of the view.

    Parameters
    ----------
    u, v : float32
    vx, vy, vz : float32
        Unit direction to the viewer; vz is at least 0.
    ax, ay : float32
        Roughness along x and y, above 0.

    Returns
    -------
    x, y, z : float32
        Unit length; z is above 0.

    References
    ----------
    .. [1] Dupuy and Benyoub, "Sampling Visible GGX Normals with Spherical Caps", Computer
       Graphics Forum 42(8), 2023.
    """
    # Step 1: stretch the surface until its faces are those of a half sphere, and the view.
    sx, sy = ax * vx, ay * vy
    inv_length = _1 / square_root(sx * sx + sy * sy + vz * vz)
    sx, sy, sz = sx * inv_length, sy * inv_length, vz * inv_length

    # Step 2: light mirrored by the half sphere towards the viewer comes evenly from the cap
    # above z = -sz. The normal is half-way; its z is a product, so that it is never 0.
    z = (_1 - v) * (_1 + sz)
    cap = z - sz
    radius = square_root(maximum(_1 - cap * cap, _0))
    x, y = sincos_turns(u)
    x, y = radius * x + sx, radius * y + sy

    # Step 3: back to the surface as it is.
    x, y = ax * x, ay * y
    inv_length = _1 / square_root(x * x + y * y + z * z)
    return x * inv_length, y * inv_length, z * inv_length


@device
def visible_normal_pdf(x, y, z, vx, vy, vz, ax, ay):
    """Density of `visible_normal` at a unit normal, per steradian.

    Parameters
    ----------
    x, y, z : float32
        The normal.
    vx, vy, vz, ax, ay : float32
        As of `visible_normal`.

    Returns
    -------
    float32
        0 where the viewer does not see it. The direction that it mirrors the viewer's into
        has this density divided by 4 times the cosine between normal and viewer.

    Notes
    -----
    It is Smith's part of the faces in sight, 2 vz / (vz + l), times cosine times density over
    vz, where l is the stretched view's length: vz goes out, and grazing views are no case of
    their own.
    """
    cosine = x * vx + y * vy + z * vz
    sx, sy = ax * vx, ay * vy
    length = square_root(sx * sx + sy * sy + vz * vz)
    return ggx_density(x, y, z, ax, ay) * _2 * maximum(cosine, _0) / (vz + length)
