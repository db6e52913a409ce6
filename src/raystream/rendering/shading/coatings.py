"""Coatings of a surface: clear coats, and fibres with a sheen.

A coat reflects as microfacets do, and lets the rest through to what is below it; fibres leave
what is below them the share of light that they do not reflect.

References
----------
Khronos, ``KHR_materials_clearcoat`` and ``KHR_materials_sheen``. The surface below fibres is
scaled by the view's factor alone; sheen that would reflect more than all light is scaled down.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device_call
from raystream.jit.simd import maximum, minimum, select
from raystream.rendering.shading.material_values import (
    looked_up,
    material_color,
    material_number,
    tinted,
)
from raystream.rendering.shading.microfacet import LEAST_ALPHA
from raystream.rendering.shading.sheen import LEAST_SHEEN, sheen_albedo
from raystream.rendering.shading.tables import COLUMNS
from raystream.rendering.shading.textures import ROLES
from raystream.rendering.shading.vectors import dot, largest, scaled

_NULL, _WHOLE = np.float32(0.0), np.float32(1.0)
_LEAST_SHEEN = np.float32(LEAST_SHEEN)

#: Reflectance at normal incidence of a coat of index 1.5.
_STRAIGHT = np.float32(0.04)

_COAT = np.int32(COLUMNS.clearcoat)
_COAT_ROUGHNESS = np.int32(COLUMNS.clearcoat_roughness)
_SHEEN = np.int32(COLUMNS.sheen_color)
_SHEEN_ROUGHNESS = np.int32(COLUMNS.sheen_roughness)
_COAT_TEXTURE = np.int32(ROLES.index("clearcoat"))
_COAT_ROUGHNESS_TEXTURE = np.int32(ROLES.index("clearcoat_roughness"))
_SHEEN_TEXTURE = np.int32(ROLES.index("sheen_color"))
_SHEEN_ROUGHNESS_TEXTURE = np.int32(ROLES.index("sheen_roughness"))


@device_call
def coat_at(tables, point, back):
    """The clear coat at a point.

    Parameters
    ----------
    tables : SceneTables
    point : Point
    back : tuple of three float64
        Unit vector to the ray's origin.

    Returns
    -------
    share, alpha : float64
        Share of the light that it reflects, 0 without a coat, and its GGX roughness.
    """
    plain = tables.textures.plain
    strength = material_number(tables, point.material, _COAT)
    strength *= looked_up(tables, point, _COAT_TEXTURE, plain)[0]
    roughness = material_number(tables, point.material, _COAT_ROUGHNESS)
    roughness *= looked_up(tables, point, _COAT_ROUGHNESS_TEXTURE, plain)[1]
    cosine = minimum(maximum(dot(back, (point.cx, point.cy, point.cz)), _NULL), _WHOLE)
    rest = _WHOLE - cosine
    fresnel = _STRAIGHT + (_WHOLE - _STRAIGHT) * (rest * rest * rest * rest * rest)
    alpha = minimum(maximum(roughness * roughness, LEAST_ALPHA), _WHOLE)
    return minimum(maximum(strength, _NULL), _WHOLE) * fresnel, alpha


@device_call
def sheen_at(tables, point, back):
    """The sheen at a point.

    Parameters
    ----------
    tables, point, back
        See `coat_at`.

    Returns
    -------
    color : tuple of three float64
        Black without sheen.
    alpha : float64
        Squared roughness; 0 without sheen.
    base : float64
        Factor of what is below.
    """
    color = material_color(tables, point.material, _SHEEN)
    red, green, blue = tinted(color, tables, point, _SHEEN_TEXTURE)
    color = minimum(red, _WHOLE), minimum(green, _WHOLE), minimum(blue, _WHOLE)
    roughness = material_number(tables, point.material, _SHEEN_ROUGHNESS)
    roughness *= looked_up(tables, point, _SHEEN_ROUGHNESS_TEXTURE, tables.textures.plain)[0]
    roughness = minimum(maximum(roughness, _LEAST_SHEEN), _WHOLE)
    cosine = minimum(dot(back, (point.nx, point.ny, point.nz)), _WHOLE)
    strongest = largest(color[0], color[1], color[2])
    reflected = strongest * sheen_albedo(tables.sheen_albedos, cosine, roughness)
    color = scaled(color, _WHOLE / maximum(reflected, _WHOLE))
    alpha = select(strongest > _NULL, roughness * roughness, _NULL)
    return color, alpha, _WHOLE - minimum(reflected, _WHOLE)
