"""GGX microfacets: reflection of glTF's metallic-roughness materials.

Microfacets reflect a share of the light by Schlick's approximation of Fresnel's equations; the
rest is scattered or transmitted, except by metals.

References
----------
Khronos, "glTF 2.0 Specification", appendix B, and ``KHR_materials_specular``. Walter et al.,
"Microfacet Models for Refraction through Rough Surfaces", 2007. Heitz, "Understanding the
Masking-Shadowing Function in Microfacet-Based BRDFs", 2014 (the height-correlated form).
"""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import as_float32, maximum, minimum, select, square_root
from raystream.rendering.sampling.ggx import visible_normal
from raystream.rendering.sampling.warp import basis
from raystream.rendering.shading.vectors import dot

#: Least roughness; smoother surfaces would need a delta lobe.
LEAST_ALPHA = np.float32(1e-3)

_LEAST_COSINE = np.float32(1e-4)
_NULL, _HALF, _WHOLE, _TWO = map(np.float32, (0.0, 0.5, 1.0, 2.0))
_PI, _INV_PI = np.float32(math.pi), np.float32(1.0 / math.pi)


@device
def schlick(color, grazing, cosine):
    """Schlick's approximation: reflectance at an angle, from those at normal and at grazing one."""
    rest = _WHOLE - minimum(maximum(cosine, _NULL), _WHOLE)
    share = rest * rest * rest * rest * rest
    return (
        color[0] + (grazing - color[0]) * share,
        color[1] + (grazing - color[1]) * share,
        color[2] + (grazing - color[2]) * share,
    )


@device_call
def eval_rough_reflection(diffuse, mirror, grazing, alpha, normal, back, toward):
    """Evaluate the reflection, with the density of mirroring by `visible_facet`.

    Parameters
    ----------
    diffuse, mirror : tuple of three float64
        Diffuse colour, and reflectance at normal incidence.
    grazing : float64
        Reflectance at grazing incidence.
    alpha : float64
        GGX roughness.
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
    length = square_root(x * x + y * y + z * z)
    is_sound = length > _NULL
    length = select(is_sound, length, _WHOLE)
    cosine = maximum(dot(normal, toward), _NULL)
    half = x / length, y / length, z / length
    view = maximum(dot(normal, back), _LEAST_COSINE)
    height = dot(normal, half)
    square = alpha * alpha
    spread = height * height * (square - _WHOLE) + _WHOLE
    density = select(is_sound, square / (_PI * spread * spread), _NULL)
    view_length = square_root(view * view * (_WHOLE - square) + square)
    light_length = square_root(cosine * cosine * (_WHOLE - square) + square)
    faces = density * cosine * _HALF / (view * light_length + cosine * view_length)
    share = schlick(mirror, grazing, dot(back, half))
    even = select(is_sound, cosine * _INV_PI, _NULL)
    color = (
        share[0] * faces + (_WHOLE - share[0]) * diffuse[0] * even,
        share[1] * faces + (_WHOLE - share[1]) * diffuse[1] * even,
        share[2] * faces + (_WHOLE - share[2]) * diffuse[2] * even,
    )
    return color, density * _HALF / (view + view_length)


@device_call
def visible_facet(alpha, normal, back, u, v):
    """Sample the normal of a microfacet, of those visible from `back`."""
    tx, ty, tz, bx, by, bz = basis(
        as_float32(normal[0]), as_float32(normal[1]), as_float32(normal[2])
    )
    across, up = (tx, ty, tz), (bx, by, bz)
    x, y, z = visible_normal(
        u,
        v,
        as_float32(dot(across, back)),
        as_float32(dot(up, back)),
        as_float32(maximum(dot(normal, back), _LEAST_COSINE)),
        as_float32(alpha),
        as_float32(alpha),
    )
    return (
        x * across[0] + y * up[0] + z * normal[0],
        x * across[1] + y * up[1] + z * normal[1],
        x * across[2] + y * up[2] + z * normal[2],
    )


@device
def smith_masking(alpha, cosine):
    """Share of microfacets that others do not hide from a direction, by its cosine; 0 if <= 0."""
    square, cosine = alpha * alpha, maximum(cosine, _NULL)
    return _TWO * cosine / (cosine + square_root(cosine * cosine * (_WHOLE - square) + square))
