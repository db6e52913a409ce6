"""How a surface scatters light: matte, glossy, mirror and glass, added up.

A surface may do several of these at once, as MTL and BART materials do. Matte and glossy
reflection spread light; mirrors and glass send it one way each, and are only ever sampled.
Directions are unit vectors that point away from the surface; `back` is to where the ray came
from.

References
----------
Lafortune and Willems, "Using the Modified Phong Reflectance Model for Physically Based
Rendering", 1994. Whitted, "An Improved Illumination Model for Shaded Display", 1980.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.render.shading.microfacet import LEAST_ALPHA, PLASTIC, rough_reflected
from raystream.render.shading.points import material_color, material_number
from raystream.render.shading.tables import COLUMNS
from raystream.render.shading.textures import ROLES, texture_color, texture_of

__all__ = [
    "Bounce",
    "Lobes",
    "dot",
    "emitted",
    "fresnel",
    "lobes_at",
    "mirrored",
    "reflected",
    "refracted",
]

_DIFFUSE = np.uint64(COLUMNS.diffuse)
_SPECULAR = np.uint64(COLUMNS.specular)
_REFLECTION = np.uint64(COLUMNS.reflection)
_TRANSMISSION = np.uint64(COLUMNS.transmission)
_SHININESS = np.uint64(COLUMNS.shininess)
_IOR = np.uint64(COLUMNS.ior)
_ROUGHNESS = np.uint64(COLUMNS.roughness)
_METALLIC = np.uint64(COLUMNS.metallic)
_EMISSION = np.uint64(COLUMNS.emission)
_EMISSION_TEXTURE = np.uint64(ROLES.index("emission"))
_DIFFUSE_TEXTURE = np.uint64(ROLES.index("diffuse"))
_ROUGHNESS_TEXTURE = np.uint64(ROLES.index("metallic_roughness"))
_SPECULAR_TEXTURE = np.uint64(ROLES.index("specular"))

Vector = tuple[float, float, float]


class Lobes(NamedTuple):
    """What a surface does at a point.

    Attributes
    ----------
    diffuse, specular, reflection, transmission : tuple of three float64
        Shares of the light that are scattered evenly, around the mirrored direction, to it,
        and through the surface; together at most 1 in each colour.
    shininess : float64
        Phong exponent.
    ior : float64
        Index of refraction of what the ray enters over that of what it leaves.
    alpha : float64
        GGX's roughness of a surface of glTF's kind, see `microfacet`: `specular` is then what it
        mirrors squarely. 0 for Phong's lobe.
    """

    diffuse: Vector
    specular: Vector
    reflection: Vector
    transmission: Vector
    shininess: float
    ior: float
    alpha: float


class Bounce(NamedTuple):
    """A direction that a surface sends a ray.

    Attributes
    ----------
    direction : tuple of three float64
    weight : tuple of three float64
        Scattered light over the direction's probability.
    pdf : float64
        Probability density over solid angle; inf for mirrors and glass.
    is_valid : bool
        Whether the ray goes on at all.
    """

    direction: Vector
    weight: Vector
    pdf: float
    is_valid: bool


@device
def dot(a, b):
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def _times(a, b):
    return a[0] * np.float64(b[0]), a[1] * np.float64(b[1]), a[2] * np.float64(b[2])


@device
def _scaled(a, factor):
    return a[0] * factor, a[1] * factor, a[2] * factor


@device
def _tinted(color, tables, point, role):
    """A colour of a material times its texture."""
    textures = tables.textures
    texture = texture_of(textures, point.material, role)
    if texture < 0:
        return color
    return _times(color, texture_color(textures, texture, point.u, point.v, textures.linear))


@device
def emitted(tables, point):
    """What the front of a surface emits."""
    color = material_color(tables, point.material, _EMISSION)
    return _tinted(color, tables, point, _EMISSION_TEXTURE)


@device
def _metal_or_plastic(tables, point, roughness, base):
    """GGX's roughness of glTF's materials, and what they scatter evenly and mirror squarely."""
    metallic = max(material_number(tables, point.material, _METALLIC), 0.0)
    textures = tables.textures
    texture = texture_of(textures, point.material, _ROUGHNESS_TEXTURE)
    if texture >= 0:
        numbers = texture_color(textures, texture, point.u, point.v, textures.plain)
        roughness, metallic = roughness * numbers[1], metallic * numbers[2]
    metallic = min(metallic, 1.0)
    plastic = 1.0 - metallic
    mirror = (
        PLASTIC * plastic + base[0] * metallic,
        PLASTIC * plastic + base[1] * metallic,
        PLASTIC * plastic + base[2] * metallic,
    )
    alpha = min(max(roughness * roughness, LEAST_ALPHA), 1.0)
    return alpha, _scaled(base, plastic), mirror


@device_call
def lobes_at(tables, point):
    """What a surface does at a point.

    Where a material's shares add up to more than 1, as files allow, all are made less, so
    that no light is made.

    Parameters
    ----------
    tables : SceneTables
    point : Point
    """
    material = point.material
    diffuse = _times(
        material_color(tables, material, _DIFFUSE), (point.red, point.green, point.blue)
    )
    diffuse = _tinted(diffuse, tables, point, _DIFFUSE_TEXTURE)
    specular = _tinted(
        material_color(tables, material, _SPECULAR), tables, point, _SPECULAR_TEXTURE
    )
    roughness = material_number(tables, material, _ROUGHNESS)
    alpha = 0.0
    if roughness >= 0.0:
        alpha, diffuse, specular = _metal_or_plastic(tables, point, roughness, diffuse)
    reflection = material_color(tables, material, _REFLECTION)
    transmission = material_color(tables, material, _TRANSMISSION)
    most = 1.0
    for k in range(3):
        # Small faces take their share of what the rest would scatter.
        both = max(diffuse[k], specular[k]) if alpha > 0.0 else diffuse[k] + specular[k]
        most = max(most, both + reflection[k] + transmission[k])
    ior = max(material_number(tables, material, _IOR), 1e-3)
    return Lobes(
        _scaled(diffuse, 1.0 / most),
        _scaled(specular, 1.0 / most),
        _scaled(reflection, 1.0 / most),
        _scaled(transmission, 1.0 / most),
        material_number(tables, material, _SHININESS),
        ior if point.is_front else 1.0 / ior,
        alpha,
    )


@device
def mirrored(back, normal):
    """The direction in which a mirror sends a ray."""
    along = 2.0 * dot(back, normal)
    return (
        along * normal[0] - back[0],
        along * normal[1] - back[1],
        along * normal[2] - back[2],
    )


@device
def fresnel(cosine, ior):
    """Share of unpolarised light that a clear surface reflects.

    Parameters
    ----------
    cosine : float64
        Between the direction that light comes from and the normal; not negative.
    ior : float64
        Index of refraction behind the surface over that before it.

    Returns
    -------
    float64
        1 beyond the angle of total reflection.
    """
    square = 1.0 - (1.0 - cosine * cosine) / (ior * ior)
    if square <= 0.0:
        return 1.0
    behind = math.sqrt(square)
    across = (cosine - ior * behind) / (cosine + ior * behind)
    along = (ior * cosine - behind) / (ior * cosine + behind)
    return 0.5 * (across * across + along * along)


@device
def refracted(back, normal, ior):
    """The direction in which a ray goes on behind a clear surface (Snell's law).

    Only where `fresnel` is below 1.
    """
    cosine = dot(back, normal)
    behind = math.sqrt(max(1.0 - (1.0 - cosine * cosine) / (ior * ior), 0.0))
    along = cosine / ior - behind
    x = along * normal[0] - back[0] / ior
    y = along * normal[1] - back[1] / ior
    z = along * normal[2] - back[2] / ior
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@device_call
def reflected(lobes, point, back, toward):
    """Light that matte and glossy reflection send back, and how likely they are to look there.

    Parameters
    ----------
    lobes : Lobes
    point : Point
    back : tuple of three float64
        To where the light goes.
    toward : tuple of three float64
        To where it comes from.

    Returns
    -------
    color : tuple of three float64
        Reflected radiance for an irradiance of 1 on a surface that faces the light: BRDF times
        cosine.
    diffuse_pdf, specular_pdf : float64
        Densities over solid angle of the two lobes.
    """
    normal = point.nx, point.ny, point.nz
    cosine = dot(normal, toward)
    if cosine <= 0.0 or dot((point.gx, point.gy, point.gz), toward) <= 0.0:
        return (0.0, 0.0, 0.0), 0.0, 0.0
    diffuse = cosine / math.pi
    if lobes.alpha > 0.0:
        color, pdf = rough_reflected(
            lobes.diffuse, lobes.specular, lobes.alpha, normal, back, toward
        )
        return color, diffuse, pdf
    color = (
        lobes.diffuse[0] * diffuse,
        lobes.diffuse[1] * diffuse,
        lobes.diffuse[2] * diffuse,
    )
    gloss = lobes.specular
    if gloss[0] + gloss[1] + gloss[2] == 0.0:  # a power takes as long as all the rest
        return color, diffuse, 0.0
    highlight = max(dot(mirrored(back, normal), toward), 0.0) ** lobes.shininess
    specular = highlight * (lobes.shininess + 2.0) / (2.0 * math.pi) * cosine
    color = (
        color[0] + gloss[0] * specular,
        color[1] + gloss[1] * specular,
        color[2] + gloss[2] * specular,
    )
    return color, diffuse, highlight * (lobes.shininess + 1.0) / (2.0 * math.pi)
