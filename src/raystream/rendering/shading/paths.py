"""Path tracing at surfaces: emission, one sample of the lights, and the next direction.

One kernel does it for a stream of paths: it adds light that surfaces emit, samples the lights
(next-event estimation) with a shadow ray, and samples the direction of the next ray. Light that
both a sample of the lights and a scattered ray may find is weighted by the power heuristic of
multiple importance sampling, with exponent 2 (Veach 1997, section 9.2.4).

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
    any_lane,
    as_int32,
    as_uint32,
    f32x16,
    gather,
    maximum,
    minimum,
    select,
    square_root,
    u32x16,
    widen,
)
from raystream.rendering.sampling.sampler import draw_lanes, draw_pair_lanes
from raystream.rendering.shading.absorption import transmittance
from raystream.rendering.shading.bsdf import emitted, eval_reflection, lobes_at
from raystream.rendering.shading.lights import sample_light, triangle_pdf
from raystream.rendering.shading.plain_scenes import plain_copy
from raystream.rendering.shading.rows import vector_at
from raystream.rendering.shading.scatter import reflection_pdf, scatter
from raystream.rendering.shading.shadow_rays import put_shadow_rays
from raystream.rendering.shading.sky_lanes import sky_pdf_lanes, sky_radiance_lanes
from raystream.rendering.shading.streams import (
    StreamCursor,
    add_lights,
    addresses_of,
    append_rows,
    batch_addresses,
    block_rows,
)
from raystream.rendering.shading.surface_points import spawn_origin, surface_points
from raystream.rendering.shading.tables import ABSORBS
from raystream.rendering.shading.vectors import dot, largest, scaled, times

#: Sampler dimensions that a path uses at each surface, and those before the first one: the
#: position in the pixel and on the lens.
_DIMENSIONS = 8
_FIRST_DIMENSION = 4

#: Of vectors.
_LANES = 16

_0, _1 = np.int32(0), np.int32(1)
_NULL, _WHOLE, _INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)

#: Largest probability of surviving Russian roulette.
_MOST_CHANCE = np.float32(0.95)


class PathOptions(NamedTuple):
    """Options of path tracing.

    Attributes
    ----------
    max_bounces : int
        Maximum number of surfaces that scatter light on its way from a light to the camera.
    samples_lights : bool
        Whether lights are sampled at each surface; if not, only scattered rays find them.
    roulette_bounce : int
        Russian roulette starts at this bounce.
    clamp : float32
        Bound on each channel of indirect light that a path adds at once; inf for no bound.
    follows_last : bool
        Whether the last surface that scatters light sends a ray on, to find emitted light. If
        not, its light is that of the samples alone.
    """

    max_bounces: int
    samples_lights: bool
    roulette_bounce: int
    clamp: np.float32 = _INF
    follows_last: bool = True


@device
def _mis_weight(pdf, other):
    """Weight of one sampling strategy against another: the power heuristic."""
    ratio = other / pdf
    share = _WHOLE / (_WHOLE + ratio * ratio)
    return select((other == _NULL) | (pdf == _INF), _WHOLE, share)


@device
def _clamped(light, most):
    """Light with its hue, and no channel above a bound."""
    brightest = largest(light[0], light[1], light[2])
    return scaled(light, select(brightest > most, most / brightest, _WHOLE))


@device
def _emission(tables, lights, options, point, back, distance, pdf, weights, mask):
    """Light of rays that hit the front of an emitter, and the lanes where there is any."""
    color = emitted(tables, point)
    mask &= point.is_front & (color[0] + color[1] + color[2] > _NULL)
    if options.samples_lights and any_lane(mask):
        distance = widen(distance) * (1.0 / tables.inverse_scale)
        cosine = dot(back, (point.gx, point.gy, point.gz))
        other = select(pdf < _INF, triangle_pdf(lights, point, distance, cosine), _NULL)
        color = scaled(color, _mis_weight(pdf, other))
    return times(weights, color), mask


@device
def _light_sampled(tables, lights, numbers, point, lobes, back, weights, mask, is_alone):
    """A sample of the lights for each point: `LightSample`, its light, and where there is any.

    `is_alone` says that no scattered ray may find the same light.
    """
    sampler, pixel, sample, dimension = numbers
    u, v = draw_pair_lanes(sampler, pixel, sample, dimension)
    choice = draw_lanes(sampler, pixel, sample, dimension + 2)
    found = sample_light(tables, lights, point, choice, u, v)
    color, pdfs = eval_reflection(lobes, point, back, found.toward)
    mask &= found.is_valid & (color[0] + color[1] + color[2] > _NULL)
    share = f32x16(_WHOLE)
    if not is_alone:
        other = reflection_pdf(lobes, point, back, pdfs)
        share = select(found.pdf < _INF, _mis_weight(found.pdf, other), _WHOLE)
    light = scaled(times(times(weights, color), found.color), share)
    return found, light, mask


@device
def shade_path_block(first, batch, tables, lights, sample, bounce, options, onward, rays):
    """Shade 16 paths at the surfaces that their rays hit.

    Parameters
    ----------
    first : int
        The first of them; lanes beyond the last path are inactive.
    batch : ShadingBatch
        Of addresses.
    tables, lights, sample, bounce, options
        See `shade_paths`.
    onward, rays : StreamCursor
        Of `Paths` and `ShadowRays`.

    Returns
    -------
    onward, rays : StreamCursor
        Behind the rows written.
    """
    paths, hits, radiance = batch.paths, batch.hits, batch.radiance
    sampler, dimension = sample.sampler, _FIRST_DIMENSION + _DIMENSIONS * bounce
    samples = u32x16(as_uint32(sample.number))
    # The first surface's light is what it emits, samples, or finds with the next ray.
    most_found = options.clamp if bounce > _1 else _INF
    most_sampled = options.clamp if bounce > _0 else _INF
    row, is_path = block_rows(first, batch)
    pixels = gather(np.int64, paths.pixels, row)
    pixel, key = as_int32(pixels - batch.first_pixel), as_uint32(pixels)
    weights = vector_at(paths.colors, row)
    dx, dy, dz = vector_at(paths.directions, row)
    pdf = gather(np.float32, paths.numbers, row)
    prim = gather(np.int32, hits.prim_id, row)
    is_hit = is_path & (prim >= _0)
    is_missed = is_path & (prim < _0)
    if any_lane(is_missed):
        share = f32x16(_WHOLE)
        if options.samples_lights:
            share = _mis_weight(pdf, sky_pdf_lanes(lights, (dx, dy, dz), is_missed))
        color = sky_radiance_lanes(lights, (dx, dy, dz), is_missed)
        color = scaled(times(weights, color), share)
        add_lights(radiance, pixel, _clamped(color, most_found), is_missed)
    if not any_lane(is_hit):
        return onward, rays

    u, v = gather(np.float32, hits.u, row), gather(np.float32, hits.v, row)
    point = surface_points(tables, maximum(prim, _0), u, v, dx, dy, dz, is_hit)
    length = square_root(dx * dx + dy * dy + dz * dz)
    back = -dx / length, -dy / length, -dz / length
    distance = gather(np.float32, hits.t, row) * length
    if tables.kinds & ABSORBS and any_lane(is_hit & ~point.is_front):
        weights = times(weights, transmittance(tables, point, distance))
    light, is_lit = _emission(tables, lights, options, point, back, distance, pdf, weights, is_hit)
    if any_lane(is_lit):
        add_lights(radiance, pixel, _clamped(light, most_found), is_lit)
    if bounce >= options.max_bounces:
        return onward, rays

    is_last = not options.follows_last and bounce + 1 >= options.max_bounces
    lobes = lobes_at(tables, point, back)
    if options.samples_lights and not lights.is_dark:
        numbers = sampler, key, samples, dimension
        found, light, is_lit = _light_sampled(
            tables, lights, numbers, point, lobes, back, weights, is_hit, is_last
        )
        light = _clamped(light, most_sampled)
        rays = put_shadow_rays(rays, is_lit, pixels, tables, point, found, light)
    if is_last:
        return onward, rays

    u, v = draw_pair_lanes(sampler, key, samples, dimension + 4)
    choice = draw_lanes(sampler, key, samples, dimension + 6)
    ray = scatter(lobes, point, back, choice, u, v)
    weights = times(weights, ray.weight)
    brightest = largest(weights[0], weights[1], weights[2])
    continues = is_hit & ray.is_valid & (brightest > _NULL)
    if bounce >= options.roulette_bounce:
        chance = minimum(brightest, _MOST_CHANCE)
        continues &= draw_lanes(sampler, key, samples, dimension + 7) < chance
        weights = scaled(weights, _WHOLE / chance)
    origins = spawn_origin(tables, point, ray.direction)
    onward = append_rows(onward, continues, pixels, origins, ray.direction, weights, ray.pdf)
    return onward, rays


@kernel
def shade_paths(batch, tables, lights, sample, bounce, options, onward, rays):
    """Shade paths at the surfaces that their rays hit, 16 at a time.

    Parameters
    ----------
    batch : ShadingBatch
        No two paths of one pixel.
    tables : SceneTables
    lights : LightTables
    sample : PixelSample
    bounce : int
        Surfaces that have scattered the paths before.
    options : PathOptions
    onward : Paths
        Room for as many, with slack (`streams.SLACK`); paths that continue are written. It may
        be the batch's.
    rays : ShadowRays
        Room for as many, with slack; shadow rays are written.

    Returns
    -------
    path_count, ray_count : int
        Rows written.
    """
    places = batch_addresses(batch)
    path_end = StreamCursor(addresses_of(onward), np.uint64(0))
    ray_end = StreamCursor(addresses_of(rays), np.uint64(0))
    for first in range(0, batch.path_count, _LANES):
        path_end, ray_end = shade_path_block(
            first, places, tables, lights, sample, bounce, options, path_end, ray_end
        )
    return np.int64(path_end.row), np.int64(ray_end.row)


shade_plain_paths = plain_copy(shade_paths)
