"""BSDFs: diffuse, glossy, mirror and transmissive lobes of a surface, coatings, and their sum.

A surface may have several lobes, as MTL and BART materials do. Mirror and transmissive lobes are
delta distributions, and are only sampled. Directions are unit vectors that point away from the
surface; `back` points to the ray's origin.

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
from raystream.jit.simd import any_lane, maximum, minimum, power, select, square_root
from raystream.rendering.shading.coatings import coat_at, sheen_at
from raystream.rendering.shading.material_values import (
    color_if,
    looked_up,
    material_color,
    material_number,
    tinted,
)
from raystream.rendering.shading.microfacet import LEAST_ALPHA, eval_rough_reflection, schlick
from raystream.rendering.shading.sheen import eval_sheen
from raystream.rendering.shading.tables import (
    COLUMNS,
    EMITS,
    HAS_COAT,
    HAS_REFLECTION,
    HAS_SHEEN,
    HAS_SPECULAR,
    HAS_TRANSMISSION,
    IS_ROUGH,
)
from raystream.rendering.shading.textures import ROLES
from raystream.rendering.shading.vectors import added, chosen, dot, largest, mirrored, scaled, times

_NULL, _WHOLE, _TWO, _HALF, _THIRD = map(np.float32, (0.0, 1.0, 2.0, 0.5, 1.0 / 3.0))
_LEAST_IOR, _LEAST = np.float32(1e-3), np.float32(1e-30)
_INV_PI, _INV_TWO_PI = np.float32(1.0 / math.pi), np.float32(0.5 / math.pi)

_DIFFUSE = np.int32(COLUMNS.diffuse)
_SPECULAR = np.int32(COLUMNS.specular)
_REFLECTION = np.int32(COLUMNS.reflection)
_TRANSMISSION = np.int32(COLUMNS.transmission)
_SHININESS = np.int32(COLUMNS.shininess)
_IOR = np.int32(COLUMNS.ior)
_ROUGHNESS = np.int32(COLUMNS.roughness)
_METALLIC = np.int32(COLUMNS.metallic)
_EMISSION = np.int32(COLUMNS.emission)
_EMISSION_TEXTURE = np.int32(ROLES.index("emission"))
_DIFFUSE_TEXTURE = np.int32(ROLES.index("diffuse"))
_ROUGHNESS_TEXTURE = np.int32(ROLES.index("metallic_roughness"))
_SPECULAR_TEXTURE = np.int32(ROLES.index("specular"))
_TRANSMISSION_TEXTURE = np.int32(ROLES.index("transmission"))
_REFLECTANCE_TEXTURE = np.int32(ROLES.index("reflectance"))

Vector = tuple[float, float, float]


class Lobes(NamedTuple):
    """The lobes of a surface's BSDF at a point.

    Attributes
    ----------
    diffuse, specular, reflection, transmission : tuple of three float64
        Reflectances: Lambertian, around the mirror direction, along it, and the transmittance;
        at most 1 in total in each channel.
    shininess : float64
        Phong exponent; of a glTF material the reflectance at grazing incidence.
    ior : float64
        Index of refraction of the medium that the ray enters over that of the one it leaves.
    alpha : float64
        GGX roughness of a glTF material, see `microfacet`: `specular` is then its reflectance at
        normal incidence. 0 for Phong's lobe.
    base : float64
        Share of light that coatings leave to all these lobes, 1 without any.
    coat : float64
        Share that a clear coat reflects, 0 without one.
    coat_alpha : float64
        Its GGX roughness.
    sheen : tuple of three float64
        Colour of fibres, black without sheen.
    sheen_alpha : float64
        Squared roughness of the fibres; 0 without sheen.
    """

    diffuse: Vector
    specular: Vector
    reflection: Vector
    transmission: Vector
    shininess: float
    ior: float
    alpha: float
    base: float
    coat: float
    coat_alpha: float
    sheen: Vector
    sheen_alpha: float


class Pdfs(NamedTuple):
    """Densities over solid angle of the samples of lobes, for one direction.

    Attributes
    ----------
    diffuse, specular, coat, sheen : float64
    """

    diffuse: float
    specular: float
    coat: float
    sheen: float


class Bounce(NamedTuple):
    """A sample of a BSDF: the direction of the next ray.

    Attributes
    ----------
    direction : tuple of three float64
    weight : tuple of three float64
        BSDF times cosine over the density.
    pdf : float64
        Density over solid angle; inf for mirrors and glass.
    is_valid : bool
        Whether the path continues.
    """

    direction: Vector
    weight: Vector
    pdf: float
    is_valid: bool


@device
def emitted(tables, point):
    """Radiance that the front of a surface emits."""
    color = color_if(tables, EMITS, point, _EMISSION)
    return tinted(color, tables, point, _EMISSION_TEXTURE)


@device
def metal_or_plastic(tables, point, roughness, base, plastic, grazing):
    """GGX roughness and share of plastic of glTF materials, and their reflectances.

    `plastic` and `grazing` are the reflectances of what is not metal, at normal and at grazing
    incidence.
    """
    metallic = maximum(material_number(tables, point.material, _METALLIC), _NULL)
    numbers = looked_up(tables, point, _ROUGHNESS_TEXTURE, tables.textures.plain)
    roughness, metallic = roughness * numbers[1], minimum(metallic * numbers[2], _WHOLE)
    rest = _WHOLE - metallic
    alpha = minimum(maximum(roughness * roughness, LEAST_ALPHA), _WHOLE)
    return alpha, rest, added(scaled(plastic, rest), base, metallic), grazing * rest + metallic


@device_call
def lobes_at(tables, point, back):
    """Evaluate the lobes of a surface at a point.

    Lobes that add up to more than 1, as files allow, are scaled down to conserve energy.

    Parameters
    ----------
    tables : SceneTables
    point : Point
    back : tuple of three float64
        Unit vector to the ray's origin.
    """
    material = point.material
    tint = tinted((point.red, point.green, point.blue), tables, point, _DIFFUSE_TEXTURE)
    diffuse = times(material_color(tables, material, _DIFFUSE), tint)
    specular = color_if(tables, HAS_SPECULAR, point, _SPECULAR)
    specular = tinted(specular, tables, point, _SPECULAR_TEXTURE)
    reflection = color_if(tables, HAS_REFLECTION, point, _REFLECTION)
    transmission = color_if(tables, HAS_TRANSMISSION, point, _TRANSMISSION)
    ior, shininess = point.nx * _NULL + _WHOLE, point.nx * _NULL + _WHOLE
    plain = tables.textures.plain
    if tables.kinds & HAS_TRANSMISSION:
        ior = maximum(material_number(tables, material, _IOR), _LEAST_IOR)
        passed = looked_up(tables, point, _TRANSMISSION_TEXTURE, plain)[0]
        transmission = scaled(transmission, passed)
    if tables.kinds & HAS_SPECULAR:
        shininess = material_number(tables, material, _SHININESS)
    roughness = point.nx * _NULL - _WHOLE
    if tables.kinds & IS_ROUGH:
        roughness = material_number(tables, material, _ROUGHNESS)
    is_rough = roughness >= _NULL
    alpha = roughness * _NULL
    if any_lane(is_rough):
        gloss = looked_up(tables, point, _REFLECTANCE_TEXTURE, plain)[0]
        rough, rest, mirror, grazing = metal_or_plastic(
            tables, point, roughness, diffuse, scaled(specular, gloss), shininess * gloss
        )
        through = scaled(times(transmission, tint), rest)
        alpha, shininess = select(is_rough, rough, alpha), select(is_rough, grazing, shininess)
        diffuse = chosen(is_rough, _less(scaled(diffuse, rest), through), diffuse)
        specular = chosen(is_rough, mirror, specular)
        transmission = chosen(is_rough, through, transmission)
    share = _WHOLE / maximum(
        largest(
            _sum(diffuse[0], specular[0], reflection[0], transmission[0], is_rough),
            _sum(diffuse[1], specular[1], reflection[1], transmission[1], is_rough),
            _sum(diffuse[2], specular[2], reflection[2], transmission[2], is_rough),
        ),
        _WHOLE,
    )
    base, coat, nothing = point.nx * _NULL + _WHOLE, point.nx * _NULL, point.nx * _NULL
    coat_alpha, sheen, sheen_alpha = coat, (nothing, nothing, nothing), nothing
    if tables.kinds & HAS_SHEEN:
        sheen, sheen_alpha, base = sheen_at(tables, point, back)
    if tables.kinds & HAS_COAT:
        coat, coat_alpha = coat_at(tables, point, back)
        base, sheen = base * (_WHOLE - coat), scaled(sheen, _WHOLE - coat)
    return Lobes(
        scaled(diffuse, share),
        scaled(specular, share),
        scaled(reflection, share),
        scaled(transmission, share),
        shininess,
        select(point.is_front, ior, _WHOLE / ior),
        alpha,
        base,
        coat,
        coat_alpha,
        sheen,
        sheen_alpha,
    )


@device
def sheen_share(lobes):
    """Share of light that fibres reflect, in their strongest channel."""
    share = maximum(_WHOLE - lobes.base - lobes.coat, _NULL)
    return select(lobes.sheen_alpha > _NULL, share, _NULL)


@device
def diffuse_albedo(lobes):
    """Share of light that is scattered: by the surface, and by fibres with a sheen."""
    color = scaled(lobes.diffuse, lobes.base)
    has_sheen = lobes.sheen_alpha > _NULL
    if any_lane(has_sheen):
        strongest = maximum(largest(lobes.sheen[0], lobes.sheen[1], lobes.sheen[2]), _LEAST)
        share = select(has_sheen, sheen_share(lobes) / strongest, _NULL)
        color = added(color, lobes.sheen, share)
    return color


@device
def glossy_albedo(lobes):
    """Reflectance of the glossy lobe, and of a clear coat."""
    red, green, blue = scaled(lobes.specular, lobes.base)
    return red + lobes.coat, green + lobes.coat, blue + lobes.coat


@device
def reflected_surroundings(lobes, lights):
    """What the rough lobe of a glTF material reflects of its surroundings, without rays.

    Else metal would be black but for highlights.

    Parameters
    ----------
    lobes : Lobes
    lights : PunctualLights
    """
    red, green, blue = lights.surroundings
    around = np.float32(red), np.float32(green), np.float32(blue)
    nothing = lobes.alpha * _NULL
    color = times(glossy_albedo(lobes), around)
    return chosen(lobes.alpha > _NULL, color, (nothing, nothing, nothing))


@device
def _less(a, b):
    """The difference of two colours, where it is positive."""
    return maximum(a[0] - b[0], _NULL), maximum(a[1] - b[1], _NULL), maximum(a[2] - b[2], _NULL)


@device
def _sum(diffuse, specular, reflection, transmission, is_rough):
    """Largest albedo of all lobes; microfacets take their share from what is below them."""
    layered = maximum(diffuse + transmission, specular) + reflection
    return select(is_rough, layered, diffuse + specular + reflection + transmission)


@device
def gloss_share(lobes, back, normal):
    """Share of the light that microfacets reflect: what is below them gets the rest.

    Parameters
    ----------
    lobes : Lobes
    back, normal : tuple of three float64
        Unit vectors on the same side.

    Returns
    -------
    float64
        0 for Phong's lobe.
    """
    is_rough = lobes.alpha > _NULL
    share = lobes.alpha * _NULL
    if any_lane(is_rough):
        rough = schlick(lobes.specular, lobes.shininess, dot(back, normal))
        share = select(is_rough, (rough[0] + rough[1] + rough[2]) * _THIRD, share)
    return share


@device
def fresnel(cosine, ior):
    """Fresnel reflectance of a dielectric for unpolarised light.

    Parameters
    ----------
    cosine : float64
        Between the incident direction and the normal; not negative.
    ior : float64
        Index of refraction behind the surface over that in front of it.

    Returns
    -------
    float64
        1 for total internal reflection.
    """
    square = _WHOLE - (_WHOLE - cosine * cosine) / (ior * ior)
    behind = square_root(maximum(square, _NULL))
    across = (cosine - ior * behind) / (cosine + ior * behind)
    along = (ior * cosine - behind) / (ior * cosine + behind)
    share = _HALF * (across * across + along * along)
    return select(square > _NULL, share, _WHOLE)


@device
def refracted(back, normal, ior):
    """The direction of the refracted ray (Snell's law).

    Only where `fresnel` is below 1.
    """
    cosine = dot(back, normal)
    behind = square_root(maximum(_WHOLE - (_WHOLE - cosine * cosine) / (ior * ior), _NULL))
    along = cosine / ior - behind
    x = along * normal[0] - back[0] / ior
    y = along * normal[1] - back[1] / ior
    z = along * normal[2] - back[2] / ior
    length = square_root(x * x + y * y + z * z)
    return x / length, y / length, z / length


@device_call
def eval_reflection(lobes, point, back, toward):
    """Evaluate diffuse and glossy reflection, with the densities of their samples.

    Parameters
    ----------
    lobes : Lobes
    point : Point
    back : tuple of three float64
        To the ray's origin.
    toward : tuple of three float64
        To the light.

    Returns
    -------
    color : tuple of three float64
        BRDF times cosine.
    pdfs : Pdfs
    """
    normal = point.nx, point.ny, point.nz
    cosine = dot(normal, toward)
    is_above = dot((point.gx, point.gy, point.gz), toward) > _NULL
    is_lit = (cosine > _NULL) & is_above
    cosine = select(is_lit, cosine, _NULL)
    diffuse_pdf = cosine * _INV_PI
    color, specular_pdf = scaled(lobes.diffuse, diffuse_pdf), cosine * _NULL
    is_rough = lobes.alpha > _NULL
    if any_lane(is_rough & is_lit):
        rough, pdf = eval_rough_reflection(
            lobes.diffuse, lobes.specular, lobes.shininess, lobes.alpha, normal, back, toward
        )
        is_rough &= is_lit
        color = chosen(is_rough, rough, color)
        specular_pdf = select(is_rough, pdf, specular_pdf)
    gloss = lobes.specular
    is_glossy = is_lit & (lobes.alpha <= _NULL) & (gloss[0] + gloss[1] + gloss[2] > _NULL)
    if any_lane(is_glossy):  # a power takes as long as everything else
        highlight = power(maximum(dot(mirrored(back, normal), toward), _NULL), lobes.shininess)
        highlight = select(is_glossy, highlight * _INV_TWO_PI, _NULL)
        shining = scaled(gloss, highlight * (lobes.shininess + _TWO) * cosine)
        color = color[0] + shining[0], color[1] + shining[1], color[2] + shining[2]
        glossy_pdf = highlight * (lobes.shininess + _WHOLE)
        specular_pdf = select(is_glossy, glossy_pdf, specular_pdf)
    color, coat_pdf, sheen_pdf = scaled(color, lobes.base), cosine * _NULL, cosine * _NULL
    has_sheen = is_lit & (lobes.sheen_alpha > _NULL)
    if any_lane(has_sheen):
        reflected = eval_sheen(lobes.sheen_alpha, normal, back, toward)
        color = added(color, lobes.sheen, select(has_sheen, reflected, _NULL))
        sheen_pdf = select(has_sheen, _INV_TWO_PI, sheen_pdf)
    normal = point.cx, point.cy, point.cz
    is_coated = is_above & (lobes.coat > _NULL) & (dot(normal, toward) > _NULL)
    if any_lane(is_coated):
        nothing = lobes.coat * _NULL
        all_ = nothing + _WHOLE
        black, white = (nothing, nothing, nothing), (all_, all_, all_)
        shining, pdf = eval_rough_reflection(
            black, white, all_, lobes.coat_alpha, normal, back, toward
        )
        color = added(color, chosen(is_coated, shining, black), lobes.coat)
        coat_pdf = select(is_coated, pdf, coat_pdf)
    return color, Pdfs(diffuse_pdf, specular_pdf, coat_pdf, sheen_pdf)
