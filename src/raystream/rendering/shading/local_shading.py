"""Local shading of first hits, without secondary rays: by unshadowed lights, or facing ratio."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    absolute,
    any_lane,
    as_int32,
    gather,
    maximum,
    square_root,
)
from raystream.rendering.shading.bsdf import (
    diffuse_albedo,
    emitted,
    eval_reflection,
    lobes_at,
    reflected_surroundings,
)
from raystream.rendering.shading.plain_scenes import plain_copy
from raystream.rendering.shading.punctual_lights import incident_light
from raystream.rendering.shading.rows import vector_at
from raystream.rendering.shading.sky_lanes import sky_radiance_lanes
from raystream.rendering.shading.streams import add_lights, batch_addresses, block_rows
from raystream.rendering.shading.surface_points import surface_points
from raystream.rendering.shading.tables import IS_ROUGH
from raystream.rendering.shading.vectors import added, chosen, dot, scaled, times

#: Of vectors.
_LANES = 16

_0 = np.int32(0)
_NULL, _WHOLE = np.float32(0.0), np.float32(1.0)


@device
def _begin(first, batch, lights):
    """Load 16 hits, and add the sky where rays miss.

    Returns
    -------
    row, pixel, prim : i32x16
        Rows of the streams and of the batch's light, and triangles.
    toward : tuple of three f32x16
        Unit directions.
    is_hit : mask16
        Not set beyond the last ray.
    """
    row, is_path = block_rows(first, batch)
    pixel = as_int32(gather(np.int64, batch.paths.pixels, row) - batch.first_pixel)
    toward = vector_at(batch.paths.directions, row)
    toward = scaled(toward, _WHOLE / square_root(dot(toward, toward)))
    prim = gather(np.int32, batch.hits.prim_id, row)
    is_missed = is_path & (prim < _0)
    if any_lane(is_missed):
        color = sky_radiance_lanes(lights, toward, is_missed)
        _add(batch, row, pixel, color, is_missed)
    return row, pixel, prim, toward, is_path & (prim >= _0)


@device
def _points(tables, hits, row, prim, toward, is_hit):
    u, v = gather(np.float32, hits.u, row), gather(np.float32, hits.v, row)
    x, y, z = toward
    return surface_points(tables, maximum(prim, _0), u, v, x, y, z, is_hit)


@device
def _add(batch, row, pixel, color, mask):
    """Add radiance to pixels, times the paths' weights."""
    add_lights(batch.radiance, pixel, times(vector_at(batch.paths.colors, row), color), mask)


@device
def unshadowed_block(first, batch, tables, lights):
    """Shade 16 hits by every light; see `shade_unshadowed`.

    Parameters
    ----------
    first : int
        The first of them; lanes beyond the last path are inactive.
    batch : ShadingBatch
        Of addresses.
    tables, lights
        See `shade_unshadowed`.
    """
    row, pixel, prim, toward, is_hit = _begin(first, batch, lights)
    if not any_lane(is_hit):
        return
    back = scaled(toward, -_WHOLE)
    point = _points(tables, batch.hits, row, prim, toward, is_hit)
    lobes = lobes_at(tables, point, back)
    red, green, blue = lights.ambient
    color = times(diffuse_albedo(lobes), (np.float32(red), np.float32(green), np.float32(blue)))
    if tables.kinds & IS_ROUGH:
        color = added(color, reflected_surroundings(lobes, lights), _WHOLE)
    glow = added(color, emitted(tables, point), _WHOLE)
    color = chosen(point.is_front, glow, color)
    for number in range(lights.light_count):
        found = incident_light(tables, lights, number, point)
        share, _ = eval_reflection(lobes, point, back, found.toward)
        more = added(color, times(share, found.color), _WHOLE)
        color = chosen(found.is_valid, more, color)
    _add(batch, row, pixel, color, is_hit)


@kernel
def shade_unshadowed(batch, tables, lights):
    """Shade hits by every light, without shadows.

    Parameters
    ----------
    batch : ShadingBatch
        No two paths of one pixel.
    tables : SceneTables
    lights : PunctualLights
    """
    places = batch_addresses(batch)
    for first in range(0, batch.path_count, _LANES):
        unshadowed_block(first, places, tables, lights)


shade_plain_unshadowed = plain_copy(shade_unshadowed)


@device
def facing_ratio_block(first, batch, tables, lights):
    """Shade 16 hits in grey; see `unshadowed_block` and `shade_facing_ratio`."""
    row, pixel, prim, toward, is_hit = _begin(first, batch, lights)
    if not any_lane(is_hit):
        return
    point = _points(tables, batch.hits, row, prim, toward, is_hit)
    cosine = absolute(dot((point.nx, point.ny, point.nz), toward))
    _add(batch, row, pixel, (cosine, cosine, cosine), is_hit)


@kernel
def shade_facing_ratio(batch, tables, lights):
    """Shade hits in grey, by the cosine between normal and view.

    Parameters
    ----------
    batch : ShadingBatch
        No two paths of one pixel.
    tables : SceneTables
    lights : PunctualLights
        Rays that miss see their sky.
    """
    places = batch_addresses(batch)
    for first in range(0, batch.path_count, _LANES):
        facing_ratio_block(first, places, tables, lights)
