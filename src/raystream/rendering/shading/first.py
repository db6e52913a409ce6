"""Shading of the first surface alone: by lights that nothing blocks, and by the view."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    absolute,
    address,
    any_lane,
    as_int32,
    gather,
    i32x16,
    lane_numbers,
    maximum,
    minimum,
    square_root,
)
from raystream.rendering.shading.bsdf import emitted, lobes_at, reflected
from raystream.rendering.shading.points import surface_points
from raystream.rendering.shading.punctual_lights import arriving
from raystream.rendering.shading.rows import vector_at
from raystream.rendering.shading.sky_lanes import sky_toward_lanes
from raystream.rendering.shading.streams import add_lights, addresses_of, hits_at
from raystream.rendering.shading.vectors import added, chosen, dot, scaled, times

__all__ = ["light_block", "light_unblocked", "shade_by_view", "view_block"]

#: Of vectors.
_LANES = 16

_0, _1 = np.int32(0), np.int32(1)
_NULL, _WHOLE = np.float32(0.0), np.float32(1.0)


@device
def _met(first, count, paths, hits, first_pixel):
    """What 16 rays meet.

    Returns
    -------
    row, pixel, prim : i32x16
        Of the streams, of the band's light, and triangles.
    toward : tuple of three f32x16
        Unit directions.
    is_hit, is_missed : mask16
        Neither beyond the last ray.
    """
    count = as_int32(count)
    row = lane_numbers(i32x16) + as_int32(first)
    is_path = row < count
    row = minimum(row, as_int32(count - _1))
    pixel = as_int32(gather(np.int64, paths.pixels, row) - first_pixel)
    toward = vector_at(paths.directions, row)
    toward = scaled(toward, _WHOLE / square_root(dot(toward, toward)))
    prim = gather(np.int32, hits.prim_id, row)
    return row, pixel, prim, toward, is_path & (prim >= _0), is_path & (prim < _0)


@device
def _points(tables, hits, row, prim, toward, is_hit):
    u, v = gather(np.float32, hits.u, row), gather(np.float32, hits.v, row)
    x, y, z = toward
    return surface_points(tables, maximum(prim, _0), u, v, x, y, z, is_hit)


@device
def _add_sky(paths, lights, row, pixel, toward, is_missed, radiance):
    color = sky_toward_lanes(lights, toward, is_missed)
    add_lights(radiance, pixel, times(vector_at(paths.colors, row), color), is_missed)


@device
def light_block(first, count, paths, hits, tables, lights, first_pixel, radiance):
    """Light the surfaces that 16 rays meet; see `light_unblocked`.

    Parameters
    ----------
    first, count : int
        The first of them, and how many rays there are: beyond, lanes do nothing.
    paths : StreamAddresses
    hits : HitAddresses
    tables, lights, first_pixel
        See `light_unblocked`.
    radiance : uint64
        Address of the pixels' light.
    """
    row, pixel, prim, toward, is_hit, is_missed = _met(first, count, paths, hits, first_pixel)
    if any_lane(is_missed):
        _add_sky(paths, lights, row, pixel, toward, is_missed, radiance)
    if not any_lane(is_hit):
        return
    back = scaled(toward, -_WHOLE)
    point = _points(tables, hits, row, prim, toward, is_hit)
    lobes = lobes_at(tables, point)
    red, green, blue = lights.ambient
    color = times(lobes.diffuse, (np.float32(red), np.float32(green), np.float32(blue)))
    glow = added(color, emitted(tables, point), _WHOLE)
    color = chosen(point.is_front, glow, color)
    for number in range(lights.light_count):
        found = arriving(tables, lights, number, point)
        share, _, _ = reflected(lobes, point, back, found.toward)
        more = added(color, times(share, found.color), _WHOLE)
        color = chosen(found.is_valid, more, color)
    add_lights(radiance, pixel, times(vector_at(paths.colors, row), color), is_hit)


@kernel
def light_unblocked(paths, hits, tables, lights, first_pixel, radiance):
    """Light the surfaces that rays meet by every light, as if nothing were in its way.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`.
    lights : PunctualLights
    """
    places, found, base = addresses_of(paths), hits_at(hits), address(radiance)
    count = len(paths.pixels)
    for first in range(0, count, _LANES):
        light_block(first, count, places, found, tables, lights, first_pixel, base)


@device
def view_block(first, count, paths, hits, tables, lights, first_pixel, radiance):
    """Show the surfaces that 16 rays meet in grey; see `light_block` and `shade_by_view`."""
    row, pixel, prim, toward, is_hit, is_missed = _met(first, count, paths, hits, first_pixel)
    if any_lane(is_missed):
        _add_sky(paths, lights, row, pixel, toward, is_missed, radiance)
    if not any_lane(is_hit):
        return
    point = _points(tables, hits, row, prim, toward, is_hit)
    cosine = absolute(dot((point.nx, point.ny, point.nz), toward))
    add_lights(radiance, pixel, scaled(vector_at(paths.colors, row), cosine), is_hit)


@kernel
def shade_by_view(paths, hits, tables, lights, first_pixel, radiance):
    """Show the surfaces that rays meet in grey, by the cosine between normal and view.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`.
    lights : PunctualLights
        Their sky is what rays that miss see.
    """
    places, found, base = addresses_of(paths), hits_at(hits), address(radiance)
    count = len(paths.pixels)
    for first in range(0, count, _LANES):
        view_block(first, count, places, found, tables, lights, first_pixel, base)
