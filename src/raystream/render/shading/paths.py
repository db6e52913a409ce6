"""Paths of light, followed backward from the eye: what happens to each at a surface.

One kernel does it for a stream of paths: light that the surface emits, a sample of the lights
(next-event estimation) as a ray to be tested, and the direction in which the path goes on.
Light that both a sample of the lights and a scattered ray may find is weighed by the balance
of their densities' squares (Veach 1997, section 9.2.4).

References
----------
Kajiya, "The Rendering Equation", 1986. Veach, "Robust Monte Carlo Methods for Light Transport
Simulation", 1997.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, device_call, kernel
from raystream.render.sampling.sampler import draw, draw_pair
from raystream.render.shading.bsdf import emitted, lobes_at, reflected
from raystream.render.shading.lights import sample_light, triangle_pdf
from raystream.render.shading.points import surface_point
from raystream.render.shading.scatter import reflection_pdf, scatter
from raystream.render.shading.sky import sky_pdf, sky_toward
from raystream.render.shading.streams import add_light, aimed, direction_of, put_path, put_ray

__all__ = ["PathRules", "follow_paths"]

#: Numbers that a path takes at each surface, and those before the first one: for the place in
#: the pixel and on the lens.
_DIMENSIONS = 8
_FIRST_DIMENSION = 4

_ONE = np.uint64(1)


class PathRules(NamedTuple):
    """How paths are followed.

    Attributes
    ----------
    max_bounces : int
        Surfaces that may scatter light on its way from a light to the eye.
    samples_lights : bool
        Whether lights are sampled at each surface; else they are found by chance only.
    roulette_bounce : int
        From so many bounces on, dim paths end by chance.
    """

    max_bounces: int
    samples_lights: bool
    roulette_bounce: int


# Not inlined, as other long functions of shading: inlined, they take the compiler most of a
# minute, and the kernel is no faster.


@device_call
def _three_numbers(sampler, pixel, sample, dimension):
    """Random numbers in [0, 1): two for a place or direction, and one for a choice."""
    u, v = draw_pair(sampler, pixel, sample, dimension)
    choice = draw(sampler, pixel, sample, dimension + 2)
    return np.float64(u), np.float64(v), np.float64(choice)


@device_call
def _number(sampler, pixel, sample, dimension):
    return np.float64(draw(sampler, pixel, sample, dimension))


@device
def _balance(pdf, other):
    """Weight of a way to find light among two, by the squares of their densities."""
    if other == 0.0 or pdf == np.inf:
        return 1.0
    ratio = other / pdf
    return 1.0 / (1.0 + ratio * ratio)


@kernel
def follow_paths(
    paths, hits, tables, lights, sampler, sample, bounce, rules, first_pixel, radiance, onward, rays
):
    """Let paths meet surfaces.

    Parameters
    ----------
    paths : Paths
    hits : tuple of t, u, v, prim_id
        The rays' nearest hits, as in `Hits`.
    tables : SceneTables
    lights : LightTables
    sampler : Sampler
    sample : int
        Which sample of their pixels they are.
    bounce : int
        Surfaces that have scattered them before.
    rules : PathRules
    first_pixel : int
        The pixel of row 0 of `radiance`.
    radiance : ndarray of shape (P, 3), float32
        Found light is added.
    onward : Paths
        Room for as many; those that go on are written. It may be `paths`.
    rays : LightRays
        Room for as many; rays to lights are written.

    Returns
    -------
    path_count, ray_count : int
        Rows written.
    """
    t, us, vs, prim_ids = hits
    path_count, ray_count = np.uint64(0), np.uint64(0)
    dimension = _FIRST_DIMENSION + _DIMENSIONS * bounce
    for i in range(np.uint64(len(paths.pixels))):
        pixel_id = paths.pixels[i]
        pixel = np.uint64(pixel_id - first_pixel)
        dx, dy, dz, length = direction_of(paths, i)
        pdf = paths.pdfs[i]
        if prim_ids[i] < 0:
            other = sky_pdf(lights, dx, dy, dz) if rules.samples_lights else 0.0
            color = sky_toward(lights, dx, dy, dz)
            add_light(radiance, pixel, paths.weights, i, color, _balance(pdf, other))
            continue
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
        back = -dx / length, -dy / length, -dz / length
        if point.is_front:
            color = emitted(tables, point)
            if color[0] + color[1] + color[2] > 0.0:
                other = 0.0
                if rules.samples_lights and pdf != np.inf:
                    distance = np.float64(t[i]) * length / tables.inverse_scale
                    cosine = back[0] * point.gx + back[1] * point.gy + back[2] * point.gz
                    other = triangle_pdf(lights, point, distance, cosine)
                add_light(radiance, pixel, paths.weights, i, color, _balance(pdf, other))
        if bounce >= rules.max_bounces:
            continue

        lobes = lobes_at(tables, point)
        if rules.samples_lights:
            u, v, choice = _three_numbers(sampler, pixel_id, sample, dimension)
            found = sample_light(tables, lights, point, choice, u, v)
            if found.is_valid:
                color, diffuse_pdf, specular_pdf = reflected(lobes, point, back, found.toward)
                if color[0] + color[1] + color[2] > 0.0:
                    other = 0.0
                    if found.pdf != np.inf:
                        other = reflection_pdf(lobes, point, back, diffuse_pdf, specular_pdf)
                    share = _balance(found.pdf, other)
                    weights = paths.weights
                    light = (
                        weights[i, 0] * color[0] * found.color[0] * share,
                        weights[i, 1] * color[1] * found.color[1] * share,
                        weights[i, 2] * color[2] * found.color[2] * share,
                    )
                    origin, toward, t_max = aimed(tables, point, found)
                    put_ray(rays, ray_count, pixel_id, origin, toward, t_max, light)
                    ray_count += _ONE

        u, v, choice = _three_numbers(sampler, pixel_id, sample, dimension + 4)
        next_ray = scatter(lobes, point, back, choice, u, v)
        if not next_ray.is_valid:
            continue
        weight = (
            paths.weights[i, 0] * next_ray.weight[0],
            paths.weights[i, 1] * next_ray.weight[1],
            paths.weights[i, 2] * next_ray.weight[2],
        )
        brightest = max(weight[0], weight[1], weight[2])
        if not brightest > 0.0:
            continue
        chance = 1.0
        if bounce >= rules.roulette_bounce:
            chance = min(brightest, 0.95)
            if _number(sampler, pixel_id, sample, dimension + 7) >= chance:
                continue
        weight = weight[0] / chance, weight[1] / chance, weight[2] / chance
        toward = next_ray.direction
        put_path(onward, path_count, pixel_id, tables, point, toward, weight, next_ray.pdf)
        path_count += _ONE
    return np.int64(path_count), np.int64(ray_count)
