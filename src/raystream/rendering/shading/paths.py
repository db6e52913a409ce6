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

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    any_lane,
    as_int32,
    as_uint32,
    f32x16,
    gather,
    i32x16,
    lane_numbers,
    mask_bits,
    maximum,
    minimum,
    popcount,
    select,
    square_root,
    u32x16,
    widen,
)
from raystream.rendering.sampling.sampler import draw_lanes, draw_pair_lanes
from raystream.rendering.shading.absorption import left_of
from raystream.rendering.shading.bsdf import emitted, lobes_at, reflected
from raystream.rendering.shading.lights import sample_light, triangle_pdf
from raystream.rendering.shading.points import surface_points
from raystream.rendering.shading.rows import vector_at
from raystream.rendering.shading.scatter import reflection_pdf, scatter
from raystream.rendering.shading.sky_lanes import sky_pdf_lanes, sky_toward_lanes
from raystream.rendering.shading.streams import (
    add_lights,
    addresses_of,
    hits_at,
    put_light_rays,
    put_paths,
)
from raystream.rendering.shading.tables import ABSORBS
from raystream.rendering.shading.vectors import dot, largest, scaled, times

__all__ = ["PathOptions", "follow_block", "follow_paths"]

#: Numbers that a path takes at each surface, and those before the first one: for the place in
#: the pixel and on the lens.
_DIMENSIONS = 8
_FIRST_DIMENSION = 4

#: Of vectors.
_LANES = 16

_0, _1 = np.int32(0), np.int32(1)
_NULL, _WHOLE, _INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)

#: That a path goes on past roulette.
_MOST_CHANCE = np.float32(0.95)


class PathOptions(NamedTuple):
    """How paths are followed.

    Attributes
    ----------
    max_bounces : int
        Surfaces that may scatter light on its way from a light to the eye.
    samples_lights : bool
        Whether lights are sampled at each surface; else they are found by chance only.
    roulette_bounce : int
        From so many bounces on, dim paths end by chance.
    clamp : float32
        The most that a path may bring to a channel at once of light that reaches the first
        surface from others; inf for no bound.
    """

    max_bounces: int
    samples_lights: bool
    roulette_bounce: int
    clamp: np.float32 = _INF


@device
def _balance(pdf, other):
    """Weight of a way to find light among two, by the squares of their densities."""
    ratio = other / pdf
    share = _WHOLE / (_WHOLE + ratio * ratio)
    return select((other == _NULL) | (pdf == _INF), _WHOLE, share)


@device
def _at_most(light, most):
    """Light with its hue, and no channel above a bound."""
    brightest = largest(light[0], light[1], light[2])
    return scaled(light, select(brightest > most, most / brightest, _WHOLE))


@device
def _light_found(tables, lights, rules, point, back, t, length, pdf, weights, mask):
    """What rays bring that meet the front of something that emits, and where any does."""
    color = emitted(tables, point)
    mask &= point.is_front & (color[0] + color[1] + color[2] > _NULL)
    if rules.samples_lights and any_lane(mask):
        distance = widen(t * length) * (1.0 / tables.inverse_scale)
        cosine = dot(back, (point.gx, point.gy, point.gz))
        other = select(pdf < _INF, triangle_pdf(lights, point, distance, cosine), _NULL)
        color = scaled(color, _balance(pdf, other))
    return times(weights, color), mask


@device
def _light_sampled(tables, lights, sampler, numbers, point, lobes, back, weights, mask):
    """A sample of the lights for each point: `LightSample`, what it brings, and where any."""
    pixel, sample, dimension = numbers
    u, v = draw_pair_lanes(sampler, pixel, sample, dimension)
    choice = draw_lanes(sampler, pixel, sample, dimension + 2)
    found = sample_light(tables, lights, point, choice, u, v)
    color, diffuse_pdf, specular_pdf = reflected(lobes, point, back, found.toward)
    mask &= found.is_valid & (color[0] + color[1] + color[2] > _NULL)
    other = reflection_pdf(lobes, point, back, diffuse_pdf, specular_pdf)
    share = select(found.pdf < _INF, _balance(found.pdf, other), _WHOLE)
    light = scaled(times(times(weights, color), found.color), share)
    return found, light, mask


@device
def follow_block(
    first,
    count,
    paths,
    hits,
    tables,
    lights,
    sampler,
    sample,
    bounce,
    rules,
    first_pixel,
    radiance,
    onward,
    path_row,
    rays,
    ray_row,
):
    """Let 16 paths meet surfaces.

    Parameters
    ----------
    first, count : int
        The first of them, and how many paths there are: beyond, lanes do nothing.
    paths, onward, rays : StreamAddresses
    hits : HitAddresses
    tables, lights, sampler, sample, bounce, rules, first_pixel
        See `follow_paths`.
    radiance : uint64
        Address of the pixels' light.
    path_row, ray_row : uint64
        Where those go that are written.

    Returns
    -------
    path_row, ray_row : uint64
        Behind those.
    """
    dimension = _FIRST_DIMENSION + _DIMENSIONS * bounce
    samples = u32x16(as_uint32(sample))
    # The light of the first surface is that which it emits, samples, or finds by the next ray.
    most_found = rules.clamp if bounce > _1 else _INF
    most_sampled = rules.clamp if bounce > _0 else _INF
    count = as_int32(count)
    row = lane_numbers(i32x16) + as_int32(first)
    is_path = row < count
    row = minimum(row, as_int32(count - _1))
    pixels = gather(np.int64, paths.pixels, row)
    pixel, key = as_int32(pixels - first_pixel), as_uint32(pixels)
    weights = vector_at(paths.colors, row)
    dx, dy, dz = vector_at(paths.directions, row)
    pdf = gather(np.float32, paths.numbers, row)
    prim = gather(np.int32, hits.prim_id, row)
    is_hit = is_path & (prim >= _0)
    is_missed = is_path & (prim < _0)
    if any_lane(is_missed):
        share = f32x16(_WHOLE)
        if rules.samples_lights:
            share = _balance(pdf, sky_pdf_lanes(lights, (dx, dy, dz), is_missed))
        color = sky_toward_lanes(lights, (dx, dy, dz), is_missed)
        color = scaled(times(weights, color), share)
        add_lights(radiance, pixel, _at_most(color, most_found), is_missed)
    if not any_lane(is_hit):
        return path_row, ray_row

    u, v = gather(np.float32, hits.u, row), gather(np.float32, hits.v, row)
    point = surface_points(tables, maximum(prim, _0), u, v, dx, dy, dz, is_hit)
    length = square_root(dx * dx + dy * dy + dz * dz)
    back = -dx / length, -dy / length, -dz / length
    t = gather(np.float32, hits.t, row)
    if tables.kinds & ABSORBS and any_lane(is_hit & ~point.is_front):
        weights = times(weights, left_of(tables, point, t * length))
    light, is_lit = _light_found(
        tables, lights, rules, point, back, t, length, pdf, weights, is_hit
    )
    if any_lane(is_lit):
        add_lights(radiance, pixel, _at_most(light, most_found), is_lit)
    if bounce >= rules.max_bounces:
        return path_row, ray_row

    lobes = lobes_at(tables, point)
    if rules.samples_lights and not lights.is_dark:
        numbers = key, samples, dimension
        found, light, is_lit = _light_sampled(
            tables, lights, sampler, numbers, point, lobes, back, weights, is_hit
        )
        light = _at_most(light, most_sampled)
        put_light_rays(rays, ray_row, is_lit, pixels, tables, point, found, light)
        ray_row += popcount(mask_bits(is_lit))

    u, v = draw_pair_lanes(sampler, key, samples, dimension + 4)
    choice = draw_lanes(sampler, key, samples, dimension + 6)
    ray = scatter(lobes, point, back, choice, u, v)
    weights = times(weights, ray.weight)
    brightest = largest(weights[0], weights[1], weights[2])
    goes_on = is_hit & ray.is_valid & (brightest > _NULL)
    if bounce >= rules.roulette_bounce:
        chance = minimum(brightest, _MOST_CHANCE)
        goes_on &= draw_lanes(sampler, key, samples, dimension + 7) < chance
        weights = scaled(weights, _WHOLE / chance)
    put_paths(onward, path_row, goes_on, pixels, tables, point, ray.direction, weights, ray.pdf)
    return path_row + popcount(mask_bits(goes_on)), ray_row


@kernel
def follow_paths(
    paths, hits, tables, lights, sampler, sample, bounce, rules, first_pixel, radiance, onward, rays
):
    """Let paths meet surfaces, 16 at a time.

    Parameters
    ----------
    paths : Paths
        No two of one pixel.
    hits : tuple of t, u, v, prim_id
        The rays' nearest hits, as in `Hits`; contiguous arrays.
    tables : SceneTables
    lights : LightTables
    sampler : Sampler
    sample : int
        Which sample of their pixels they are.
    bounce : int
        Surfaces that have scattered them before.
    rules : PathOptions
    first_pixel : int
        The pixel of row 0 of `radiance`.
    radiance : ndarray of shape (P, 3), float32
        Found light is added.
    onward : Paths
        Room for as many, with slack (`streams.SLACK`); those that go on are written. It may be
        `paths`.
    rays : ShadowRays
        Room for as many, with slack; rays to lights are written.

    Returns
    -------
    path_count, ray_count : int
        Rows written.
    """
    path_count, ray_count = np.uint64(0), np.uint64(0)
    count = len(paths.pixels)
    for first in range(0, count, _LANES):
        path_count, ray_count = follow_block(
            first,
            count,
            addresses_of(paths),
            hits_at(hits),
            tables,
            lights,
            sampler,
            sample,
            bounce,
            rules,
            first_pixel,
            address(radiance),
            addresses_of(onward),
            path_count,
            addresses_of(rays),
            ray_count,
        )
    return np.int64(path_count), np.int64(ray_count)
