"""Sampling BSDFs: directions of the next rays of 16 paths."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import any_lane, minimum, select
from raystream.rendering.sampling.warp import cosine_hemisphere, power_cosine, to_world
from raystream.rendering.shading.bsdf import (
    Bounce,
    eval_reflection,
    fresnel,
    gloss_share,
    refracted,
)
from raystream.rendering.shading.microfacet import rough_direction
from raystream.rendering.shading.vectors import added, chosen, dot, mirrored, scaled

__all__ = ["reflection_pdf", "scatter"]

_NULL, _WHOLE = np.float32(0.0), np.float32(1.0)
_THIRD, _INF = np.float32(1.0 / 3.0), np.float32(np.inf)


@device
def _mean(color):
    return (color[0] + color[1] + color[2]) * _THIRD


@device
def _shares(lobes, back, normal):
    """Probabilities of the lobes, and the Fresnel reflectance of the transmissive part.

    Returns
    -------
    diffuse, specular, mirror, through, clear : f32x16
        The first four add up to 1, or are 0.
    below : f32x16
        Share of the light that microfacets let through.
    """
    gloss = gloss_share(lobes, back, normal)
    below = _WHOLE - gloss
    diffuse = _mean(lobes.diffuse) * below
    specular = select(lobes.alpha > _NULL, gloss, _mean(lobes.specular))
    mirror, through = _mean(lobes.reflection), _mean(lobes.transmission) * below
    clear = through * _NULL
    is_clear = (through > _NULL) & (lobes.ior != _WHOLE)
    if any_lane(is_clear):
        share = fresnel(minimum(dot(back, normal), _WHOLE), lobes.ior)
        clear = select(is_clear, share, clear)
    mirror = mirror + clear * through
    through = (_WHOLE - clear) * through
    total = diffuse + specular + mirror + through
    factor = select(total > _NULL, _WHOLE / total, _NULL)
    return diffuse * factor, specular * factor, mirror * factor, through * factor, clear, below


@device
def reflection_pdf(lobes, point, back, diffuse_pdf, specular_pdf):
    """Density of `scatter` for a direction, from the densities that `eval_reflection` returns."""
    diffuse, specular, _, _, _, _ = _shares(lobes, back, (point.nx, point.ny, point.nz))
    return diffuse * diffuse_pdf + specular * specular_pdf


@device
def _shining(toward, is_specular, lobes, normal, back, u, v):
    """Directions with those of the glossy lobe, where that was chosen."""
    is_rough = is_specular & (lobes.alpha > _NULL)
    if any_lane(is_rough):
        toward = chosen(is_rough, rough_direction(lobes.alpha, normal, back, u, v), toward)
    is_glossy = is_specular & (lobes.alpha <= _NULL)
    if any_lane(is_glossy):
        x, y, z = power_cosine(u, v, lobes.shininess)
        toward = chosen(is_glossy, to_world(x, y, z, *mirrored(back, normal)), toward)
    return toward


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
    """
    normal, triangle = (point.nx, point.ny, point.nz), (point.gx, point.gy, point.gz)
    diffuse, specular, mirror, through, clear, below = _shares(lobes, back, normal)
    transmission = scaled(lobes.transmission, below)
    scattered = diffuse + specular
    x, y, z = cosine_hemisphere(u, v)
    toward = to_world(x, y, z, *normal)
    is_specular = (choice >= diffuse) & (choice < scattered)
    if any_lane(is_specular):
        toward = _shining(toward, is_specular, lobes, normal, back, u, v)
    color, diffuse_pdf, specular_pdf = eval_reflection(lobes, point, back, toward)
    pdf = diffuse * diffuse_pdf + specular * specular_pdf
    is_valid = (choice < scattered) & (pdf > _NULL)
    weight = scaled(color, _WHOLE / pdf)

    is_mirrored = (choice >= scattered) & (choice < scattered + mirror)
    if any_lane(is_mirrored):
        direction = mirrored(back, normal)
        is_mirrored &= dot(triangle, direction) > _NULL
        light = added(lobes.reflection, transmission, clear)
        toward = chosen(is_mirrored, direction, toward)
        weight = chosen(is_mirrored, scaled(light, _WHOLE / mirror), weight)
        pdf = select(is_mirrored, _INF, pdf)
        is_valid |= is_mirrored

    is_through = (choice >= scattered + mirror) & (through > _NULL)
    if any_lane(is_through):
        direction = refracted(back, normal, lobes.ior)
        is_through &= dot(triangle, direction) < _NULL
        share = through * lobes.ior * lobes.ior / (_WHOLE - clear)
        toward = chosen(is_through, direction, toward)
        weight = chosen(is_through, scaled(transmission, _WHOLE / share), weight)
        pdf = select(is_through, _INF, pdf)
        is_valid |= is_through
    return Bounce(toward, weight, pdf, is_valid)
