"""Rough metal and plastic: glTF's metallic-roughness reflection, by small mirrors (GGX).

A share of the light, by Fresnel (Schlick's approximation), is mirrored by small faces whose
normals spread around the surface's; the rest is scattered evenly, but not by metals.

References
----------
Khronos, "glTF 2.0 Specification", appendix B. Walter et al., "Microfacet Models for Refraction
through Rough Surfaces", 2007. Heitz, "Understanding the Masking-Shadowing Function in
Microfacet-Based BRDFs", 2014 (the height-correlated form).
"""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.render.sampling.ggx import visible_normal
from raystream.render.sampling.warp import basis

__all__ = ["LEAST_ALPHA", "PLASTIC", "mirrored_share", "rough_direction", "rough_reflected"]

#: What a surface that is no metal mirrors of light that meets it squarely (an index of 1.5).
PLASTIC = 0.04

#: Smoothest surface, as GGX's parameter; smoother ones would need mirrors.
LEAST_ALPHA = 1e-3

_LEAST_COSINE = 1e-4


@device
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def mirrored_share(color, cosine):
    """What small faces mirror at an angle, by what they mirror squarely (Schlick)."""
    rest = 1.0 - min(max(cosine, 0.0), 1.0)
    grazing = rest * rest * rest * rest * rest
    return (
        color[0] + (1.0 - color[0]) * grazing,
        color[1] + (1.0 - color[1]) * grazing,
        color[2] + (1.0 - color[2]) * grazing,
    )


@device_call
def rough_reflected(diffuse, mirror, alpha, normal, back, toward):
    """Light sent back, and the density of `rough_direction` there.

    Parameters
    ----------
    diffuse, mirror : tuple of three float64
        What is scattered evenly of what is not mirrored; what is mirrored squarely.
    alpha : float64
        GGX's roughness.
    normal, back, toward : tuple of three float64
        Unit vectors; `toward` is on the normal's side.

    Returns
    -------
    color : tuple of three float64
        BRDF times cosine.
    pdf : float64
        Over solid angle.
    """
    x, y, z = back[0] + toward[0], back[1] + toward[1], back[2] + toward[2]
    length = math.sqrt(x * x + y * y + z * z)
    cosine = _dot(normal, toward)
    if not length > 0.0:
        return (0.0, 0.0, 0.0), 0.0
    half = x / length, y / length, z / length
    view = max(_dot(normal, back), _LEAST_COSINE)
    height = _dot(normal, half)
    square = alpha * alpha
    spread = height * height * (square - 1.0) + 1.0
    density = square / (math.pi * spread * spread)
    view_length = math.sqrt(view * view * (1.0 - square) + square)
    light_length = math.sqrt(cosine * cosine * (1.0 - square) + square)
    faces = density * cosine * 0.5 / (view * light_length + cosine * view_length)
    share = mirrored_share(mirror, _dot(back, half))
    even = cosine / math.pi
    color = (
        share[0] * faces + (1.0 - share[0]) * diffuse[0] * even,
        share[1] * faces + (1.0 - share[1]) * diffuse[1] * even,
        share[2] * faces + (1.0 - share[2]) * diffuse[2] * even,
    )
    return color, density * 0.5 / (view + view_length)


@device_call
def rough_direction(alpha, normal, back, u, v):
    """A direction into which a small face mirrors, of those that are seen from `back`."""
    tx, ty, tz, bx, by, bz = basis(
        np.float32(normal[0]), np.float32(normal[1]), np.float32(normal[2])
    )
    across = np.float64(tx), np.float64(ty), np.float64(tz)
    up = np.float64(bx), np.float64(by), np.float64(bz)
    x, y, z = visible_normal(
        np.float32(u),
        np.float32(v),
        np.float32(_dot(across, back)),
        np.float32(_dot(up, back)),
        np.float32(max(_dot(normal, back), _LEAST_COSINE)),
        np.float32(alpha),
        np.float32(alpha),
    )
    half = (
        x * across[0] + y * up[0] + z * normal[0],
        x * across[1] + y * up[1] + z * normal[1],
        x * across[2] + y * up[2] + z * normal[2],
    )
    along = 2.0 * _dot(back, half)
    return (
        along * half[0] - back[0],
        along * half[1] - back[1],
        along * half[2] - back[2],
    )
