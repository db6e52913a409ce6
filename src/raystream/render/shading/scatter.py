"""Sending a ray on from a surface, in a direction chosen by what the surface does."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.render.sampling.warp import basis, cosine_hemisphere, power_cosine
from raystream.render.shading.bsdf import (
    Bounce,
    dot,
    fresnel,
    mirrored,
    reflected,
    refracted,
)
from raystream.render.shading.microfacet import mirrored_share, rough_direction

__all__ = ["reflection_pdf", "scatter"]

_NOTHING = (0.0, 0.0, 0.0)


@device
def _mean(color):
    return (color[0] + color[1] + color[2]) / 3.0


@device
def _over(color, divisor):
    return color[0] / divisor, color[1] / divisor, color[2] / divisor


@device
def _shares(lobes, back, normal):
    """How often each lobe is chosen, and what the surface's clear part reflects (Fresnel).

    Returns
    -------
    diffuse, specular, mirror, through, clear : float64
        The first four add up to 1, or are 0.
    """
    clear = 0.0
    if _mean(lobes.transmission) > 0.0 and lobes.ior != 1.0:
        clear = fresnel(min(dot(back, normal), 1.0), lobes.ior)
    diffuse, specular = _mean(lobes.diffuse), _mean(lobes.specular)
    if lobes.alpha > 0.0:
        specular = _mean(mirrored_share(lobes.specular, dot(back, normal)))
        diffuse *= 1.0 - specular
    mirror = _mean(lobes.reflection) + clear * _mean(lobes.transmission)
    through = (1.0 - clear) * _mean(lobes.transmission)
    total = diffuse + specular + mirror + through
    if total == 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    return diffuse / total, specular / total, mirror / total, through / total, clear


@device
def reflection_pdf(lobes, point, back, diffuse_pdf, specular_pdf):
    """Density with which `scatter` chooses a direction of which `reflected` gave the densities."""
    diffuse, specular, _, _, _ = _shares(lobes, back, (point.nx, point.ny, point.nz))
    return diffuse * diffuse_pdf + specular * specular_pdf


@device
def _turned(x, y, z, normal):
    """A direction about +z as one about a normal."""
    tx, ty, tz, bx, by, bz = basis(
        np.float32(normal[0]), np.float32(normal[1]), np.float32(normal[2])
    )
    return (
        x * tx + y * bx + z * normal[0],
        x * ty + y * by + z * normal[1],
        x * tz + y * bz + z * normal[2],
    )


@device
def _none():
    return Bounce(_NOTHING, _NOTHING, 0.0, False)


@device_call
def scatter(lobes, point, back, choice, u, v):
    """Choose a direction in which a ray goes on.

    Parameters
    ----------
    lobes : Lobes
    point : Point
    back : tuple of three float64
        Unit vector to where the ray came from.
    choice, u, v : float64
        Random numbers in [0, 1).

    Returns
    -------
    Bounce

    Notes
    -----
    A ray that enters glass is narrowed with all that come along, and one that leaves it spread:
    radiance in glass is the squared index of refraction times as large.
    """
    normal = point.nx, point.ny, point.nz
    diffuse, specular, mirror, through, clear = _shares(lobes, back, normal)
    if choice < diffuse + specular:
        if choice < diffuse:
            x, y, z = cosine_hemisphere(np.float32(u), np.float32(v))
            toward = _turned(np.float64(x), np.float64(y), np.float64(z), normal)
        elif lobes.alpha > 0.0:
            toward = rough_direction(lobes.alpha, normal, back, u, v)
        else:
            x, y, z = power_cosine(np.float32(u), np.float32(v), np.float32(lobes.shininess))
            axis = mirrored(back, normal)
            toward = _turned(np.float64(x), np.float64(y), np.float64(z), axis)
        color, diffuse_pdf, specular_pdf = reflected(lobes, point, back, toward)
        pdf = diffuse * diffuse_pdf + specular * specular_pdf
        if not pdf > 0.0:
            return _none()
        return Bounce(toward, _over(color, pdf), pdf, True)
    if choice < diffuse + specular + mirror:
        toward = mirrored(back, normal)
        if dot((point.gx, point.gy, point.gz), toward) <= 0.0:
            return _none()
        weight = (
            lobes.reflection[0] + clear * lobes.transmission[0],
            lobes.reflection[1] + clear * lobes.transmission[1],
            lobes.reflection[2] + clear * lobes.transmission[2],
        )
        return Bounce(toward, _over(weight, mirror), np.inf, True)
    if not through > 0.0:
        return _none()
    toward = refracted(back, normal, lobes.ior)
    if dot((point.gx, point.gy, point.gz), toward) >= 0.0:
        return _none()
    share = through * lobes.ior * lobes.ior / (1.0 - clear)
    return Bounce(toward, _over(lobes.transmission, share), np.inf, True)
