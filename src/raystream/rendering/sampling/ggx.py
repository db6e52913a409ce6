"""Sampling of visible GGX microfacet normals."""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import maximum, sincos_turns, square_root

_0, _1, _2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_PI = np.float32(math.pi)


@device
def visible_normal(u, v, vx, vy, vz, ax, ay):
    """Sample a normal of the microfacets visible to a viewer, by projected area.

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
    # Step 1: stretch surface and view, so that microfacets form a hemisphere.
    sx, sy = ax * vx, ay * vy
    inv_length = _1 / square_root(sx * sx + sy * sy + vz * vz)
    sx, sy, sz = sx * inv_length, sy * inv_length, vz * inv_length

    # Step 2: directions reflected by the hemisphere are uniform on the spherical cap above
    # z = -sz. The normal is the half vector; its z is a product, so that it is never 0.
    z = (_1 - v) * (_1 + sz)
    cap = z - sz
    radius = square_root(maximum(_1 - cap * cap, _0))
    x, y = sincos_turns(u)
    x, y = radius * x + sx, radius * y + sy

    # Step 3: transform back to the surface.
    x, y = ax * x, ay * y
    inv_length = _1 / square_root(x * x + y * y + z * z)
    return x * inv_length, y * inv_length, z * inv_length
