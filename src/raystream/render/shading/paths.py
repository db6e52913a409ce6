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

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, device_call, kernel
from raystream.render.sampling.sampler import draw, draw_pair
from raystream.render.shading.bsdf import lobes_at, reflected
from raystream.render.shading.lights import sample_light, triangle_pdf
from raystream.render.shading.points import material_color, spawned, surface_point, to_world
from raystream.render.shading.scatter import reflection_pdf, scatter
from raystream.render.shading.tables import COLUMNS
from raystream.render.shading.textures import ROLES, texture_color, texture_of

__all__ = [
    "LightRays",
    "PathRules",
    "Paths",
    "add_light",
    "add_unblocked",
    "emitted",
    "follow_paths",
]

_EMISSION = np.uint64(COLUMNS.emission)
_EMISSION_TEXTURE = np.uint64(ROLES.index("emission"))

#: Numbers that a path takes at each surface, and those before the first one: for the place in
#: the pixel and on the lens.
_DIMENSIONS = 8
_FIRST_DIMENSION = 4

_ONE = np.uint64(1)
_INF = np.float32(np.inf)


class Paths(NamedTuple):
    """A stream of paths, each at the start of a ray.

    Attributes
    ----------
    pixels : ndarray of shape (N,), int64
    origins : ndarray of shape (N, 3), float64
        World space.
    directions : ndarray of shape (N, 3), float32
    weights : ndarray of shape (N, 3), float32
        What part of the light that a ray finds reaches its pixel.
    pdfs : ndarray of shape (N,), float64
        Density over solid angle with which the direction was chosen; inf where no other way
        finds its light: from the eye, from mirrors and through glass.
    """

    pixels: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float32]
    weights: NDArray[np.float32]
    pdfs: NDArray[np.float64]

    @classmethod
    def empty(cls, count: int) -> Paths:
        """Room for so many."""
        return cls(
            np.empty(count, np.int64),
            np.empty((count, 3)),
            np.empty((count, 3), np.float32),
            np.empty((count, 3), np.float32),
            np.empty(count),
        )

    def first(self, count: int) -> Paths:
        """The first `count` of them."""
        return self._replace(**{name: array[:count] for name, array in self._asdict().items()})


class LightRays(NamedTuple):
    """Rays to lights, and what they bring if nothing is in their way.

    Attributes
    ----------
    pixels : ndarray of shape (N,), int64
    origins : ndarray of shape (N, 3), float64
        World space.
    directions : ndarray of shape (N, 3), float32
    t_max : ndarray of shape (N,), float32
    light : ndarray of shape (N, 3), float32
    """

    pixels: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float32]
    t_max: NDArray[np.float32]
    light: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> LightRays:
        """Room for so many."""
        return cls(
            np.empty(count, np.int64),
            np.empty((count, 3)),
            np.empty((count, 3), np.float32),
            np.empty(count, np.float32),
            np.empty((count, 3), np.float32),
        )

    def first(self, count: int) -> LightRays:
        """The first `count` of them."""
        return self._replace(**{name: array[:count] for name, array in self._asdict().items()})


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
def add_light(radiance, pixel, weights, i, color, factor):
    """Add light that path i brings to its pixel."""
    radiance[pixel, 0] += np.float32(weights[i, 0] * color[0] * factor)
    radiance[pixel, 1] += np.float32(weights[i, 1] * color[1] * factor)
    radiance[pixel, 2] += np.float32(weights[i, 2] * color[2] * factor)


@device
def _balance(pdf, other):
    """Weight of a way to find light among two, by the squares of their densities."""
    if other == 0.0 or pdf == np.inf:
        return 1.0
    ratio = other / pdf
    return 1.0 / (1.0 + ratio * ratio)


@device
def emitted(tables, point):
    """What the front of a surface emits."""
    color = material_color(tables, point.material, _EMISSION)
    texture = texture_of(tables.textures, point.material, _EMISSION_TEXTURE)
    if texture >= 0:
        tint = texture_color(tables.textures, texture, point.u, point.v, tables.textures.linear)
        return color[0] * tint[0], color[1] * tint[1], color[2] * tint[2]
    return color


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
        dx = np.float64(paths.directions[i, 0])
        dy = np.float64(paths.directions[i, 1])
        dz = np.float64(paths.directions[i, 2])
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        pdf = paths.pdfs[i]
        if prim_ids[i] < 0:
            other = lights.sky_density if rules.samples_lights else 0.0
            add_light(radiance, pixel, paths.weights, i, lights.sky, _balance(pdf, other))
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
                    row = ray_count
                    ray_count += _ONE
                    rays.pixels[row] = pixel_id
                    x, y, z = spawned(tables, point, found.toward)
                    rays.origins[row, 0], rays.origins[row, 1], rays.origins[row, 2] = x, y, z
                    toward, t_max = found.toward, _INF
                    if not found.is_far:
                        target = found.target
                        px, py, pz = to_world(tables, target[0], target[1], target[2])
                        toward, t_max = (px - x, py - y, pz - z), np.float32(1.0)
                    rays.t_max[row] = t_max
                    for k in range(3):
                        rays.directions[row, k] = np.float32(toward[k])
                        rays.light[row, k] = np.float32(
                            paths.weights[i, k] * color[k] * found.color[k] * share
                        )

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
        row = path_count
        path_count += _ONE
        x, y, z = spawned(tables, point, next_ray.direction)
        onward.pixels[row] = pixel_id
        onward.origins[row, 0], onward.origins[row, 1], onward.origins[row, 2] = x, y, z
        onward.pdfs[row] = next_ray.pdf
        for k in range(3):
            onward.directions[row, k] = np.float32(next_ray.direction[k])
            onward.weights[row, k] = np.float32(weight[k] / chance)
    return np.int64(path_count), np.int64(ray_count)


@kernel
def add_unblocked(rays, blocked, first_pixel, radiance):
    """Add what rays to lights bring where nothing is in their way.

    Parameters
    ----------
    rays : LightRays
    blocked : ndarray of shape (N,), bool
    first_pixel, radiance
        See `follow_paths`.
    """
    for i in range(np.uint64(len(rays.pixels))):
        if not blocked[i]:
            pixel = np.uint64(rays.pixels[i] - first_pixel)
            for k in range(3):
                radiance[pixel, k] += rays.light[i, k]
