"""Sampling BSDFs: directions of the next rays of 16 paths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import any_lane, f32x16, maximum, minimum, select
from raystream.rendering.sampling.warp import cosine_hemisphere, power_cosine, to_world
from raystream.rendering.shading.bsdf import (
    Bounce,
    eval_reflection,
    fresnel,
    gloss_share,
    refracted,
    sheen_share,
)
from raystream.rendering.shading.microfacet import LEAST_ALPHA, smith_masking, visible_facet
from raystream.rendering.shading.vectors import added, chosen, dot, mirrored, scaled

_NULL, _WHOLE, _TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_THIRD, _INF = np.float32(1.0 / 3.0), np.float32(np.inf)


class Shares(NamedTuple):
    """Probabilities of lobes, and what they follow from.

    Attributes
    ----------
    diffuse, specular, coat, sheen, mirror, through : f32x16
        They add up to 1, or are 0.
    clear : f32x16
        Fresnel reflectance of the transmissive part.
    below : f32x16
        Share of the light that microfacets and coatings let through.
    """

    diffuse: float
    specular: float
    coat: float
    sheen: float
    mirror: float
    through: float
    clear: float
    below: float


@device
def _mean(color):
    return (color[0] + color[1] + color[2]) * _THIRD


@device
def _shares(lobes, back, normal, facet):
    """Probabilities of the lobes; `facet` is the normal by which glass reflects."""
    gloss = gloss_share(lobes, back, normal)
    below = (_WHOLE - gloss) * lobes.base
    diffuse = _mean(lobes.diffuse) * below
    specular = select(lobes.alpha > _NULL, gloss, _mean(lobes.specular)) * lobes.base
    coat, sheen = lobes.coat, sheen_share(lobes)
    mirror, through = _mean(lobes.reflection) * lobes.base, _mean(lobes.transmission) * below
    clear = through * _NULL
    is_clear = (through > _NULL) & (lobes.ior != _WHOLE)
    if any_lane(is_clear):
        share = fresnel(minimum(maximum(dot(back, facet), _NULL), _WHOLE), lobes.ior)
        clear = select(is_clear, share, clear)
    mirror = mirror + clear * through
    through = (_WHOLE - clear) * through
    total = diffuse + specular + mirror + through + coat + sheen
    factor = select(total > _NULL, _WHOLE / total, _NULL)
    return Shares(
        diffuse * factor,
        specular * factor,
        coat * factor,
        sheen * factor,
        mirror * factor,
        through * factor,
        clear,
        below,
    )


@device
def _pdf(shares, pdfs):
    pdf = shares.diffuse * pdfs.diffuse + shares.specular * pdfs.specular
    return pdf + shares.coat * pdfs.coat + shares.sheen * pdfs.sheen


@device
def reflection_pdf(lobes, point, back, pdfs):
    """Density of `scatter` for a direction, from the densities that `eval_reflection` returns."""
    normal = point.nx, point.ny, point.nz
    return _pdf(_shares(lobes, back, normal, normal), pdfs)


@device
def _shining(toward, is_specular, is_coat, lobes, point, back, u, v):
    """Directions with those of glossy lobes and coats, where one was chosen."""
    normal, coat = (point.nx, point.ny, point.nz), (point.cx, point.cy, point.cz)
    is_rough = is_coat | (is_specular & (lobes.alpha > _NULL))
    if any_lane(is_rough):
        alpha = select(is_coat, lobes.coat_alpha, lobes.alpha)
        facet = visible_facet(alpha, chosen(is_coat, coat, normal), back, u, v)
        toward = chosen(is_rough, mirrored(back, facet), toward)
    is_glossy = is_specular & (lobes.alpha <= _NULL)
    if any_lane(is_glossy):
        x, y, z = power_cosine(u, v, lobes.shininess)
        toward = chosen(is_glossy, to_world(x, y, z, *mirrored(back, normal)), toward)
    return toward


@device
def _through(back, normal, facet, ior, is_frosted):
    """Directions behind the surface: refracted; of rough panes, reflected and turned over."""
    direction = refracted(back, facet, ior)
    is_pane = is_frosted & (ior == _WHOLE)
    if any_lane(is_pane):
        above = mirrored(back, facet)
        turned = added(above, normal, -_TWO * dot(above, normal))
        direction = chosen(is_pane, turned, direction)
    return direction


@device_call
def scatter(lobes, point, back, choice, u, v):
    """Sample the directions of the next rays.

    Parameters
    ----------
    lobes : Lobes
    point : Point
    back : tuple of three f32x16
        Unit vectors to the rays' origins.
    choice, u, v : f32x16
        Random numbers in [0, 1).

    Returns
    -------
    Bounce
        Of vectors.

    Notes
    -----
    Refraction changes solid angles: radiance in glass is larger by the squared index of
    refraction.

    Rough glass reflects and refracts at a visible microfacet, with the share of light that other
    microfacets let pass (Walter et al. 2007, section 5.3); so does a mirror lobe of such a
    material. As lights are not sampled through it, its density counts as infinite.
    """
    normal, triangle = (point.nx, point.ny, point.nz), (point.gx, point.gy, point.gz)
    is_frosted = (lobes.alpha > LEAST_ALPHA) & (_mean(lobes.transmission) > _NULL)
    facet = normal
    if any_lane(is_frosted):
        facet = chosen(is_frosted, visible_facet(lobes.alpha, normal, back, u, v), normal)
    shares = _shares(lobes, back, normal, facet)
    transmission = scaled(lobes.transmission, shares.below)
    glossy = shares.diffuse + shares.specular
    coated = glossy + shares.coat
    scattered = coated + shares.sheen
    x, y, z = cosine_hemisphere(u, v)
    toward = to_world(x, y, z, *normal)
    is_specular = (choice >= shares.diffuse) & (choice < glossy)
    is_coat = (choice >= glossy) & (choice < coated)
    if any_lane(is_specular | is_coat):
        toward = _shining(toward, is_specular, is_coat, lobes, point, back, u, v)
    is_sheen = (choice >= coated) & (choice < scattered)
    if any_lane(is_sheen):
        x, y, z = power_cosine(u, v, u * _NULL)  # all directions alike
        toward = chosen(is_sheen, to_world(x, y, z, *normal), toward)
    color, pdfs = eval_reflection(lobes, point, back, toward)
    pdf = _pdf(shares, pdfs)
    is_valid = (choice < scattered) & (pdf > _NULL)
    weight = scaled(color, _WHOLE / pdf)

    mirror = shares.mirror
    is_mirrored = (choice >= scattered) & (choice < scattered + mirror)
    if any_lane(is_mirrored):
        direction = mirrored(back, facet)
        is_mirrored &= dot(triangle, direction) > _NULL
        light = added(scaled(lobes.reflection, lobes.base), transmission, shares.clear)
        passed = _unhidden(lobes, is_frosted, dot(normal, direction))
        toward = chosen(is_mirrored, direction, toward)
        weight = chosen(is_mirrored, scaled(light, passed / mirror), weight)
        pdf = select(is_mirrored, _INF, pdf)
        is_valid |= is_mirrored

    is_through = (choice >= scattered + mirror) & (shares.through > _NULL)
    if any_lane(is_through):
        direction = _through(back, normal, facet, lobes.ior, is_frosted)
        is_through &= dot(triangle, direction) < _NULL
        share = shares.through * lobes.ior * lobes.ior / (_WHOLE - shares.clear)
        passed = _unhidden(lobes, is_frosted, -dot(normal, direction))
        toward = chosen(is_through, direction, toward)
        weight = chosen(is_through, scaled(transmission, passed / share), weight)
        pdf = select(is_through, _INF, pdf)
        is_valid |= is_through
    return Bounce(toward, weight, pdf, is_valid)


@device
def _unhidden(lobes, is_frosted, cosine):
    """Share of light that leaves rough glass past its microfacets; 1 for other surfaces."""
    passed = f32x16(_WHOLE)
    if any_lane(is_frosted):
        passed = select(is_frosted, smith_masking(lobes.alpha, cosine), passed)
    return passed
