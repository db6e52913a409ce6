"""Shading of the first surface alone: by lights that nothing blocks, and by the view."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, gather
from raystream.render.shading.bsdf import emitted, lobes_at, reflected
from raystream.render.shading.classic import arriving
from raystream.render.shading.points import surface_point
from raystream.render.shading.sky import sky_toward
from raystream.render.shading.streams import (
    add_light,
    addresses_of,
    direction_of,
    hits_at,
    weights_of,
)
from raystream.render.shading.vectors import dot, times

__all__ = ["light_first", "light_unblocked", "shade_by_view", "view_first"]


@device
def light_first(i, paths, hits, tables, lights, first_pixel, radiance):
    """Light the surface that ray i meets; see `light_unblocked`.

    Parameters
    ----------
    i : uint64
    paths : StreamAddresses
    hits : HitAddresses
    tables, lights, first_pixel
        See `light_unblocked`.
    radiance : uint64
        Address of the pixels' light.
    """
    pixel, weights = gather(np.int64, paths.pixels, i) - first_pixel, weights_of(paths, i)
    dx, dy, dz, length = direction_of(paths, i)
    prim_id = gather(np.int32, hits.prim_id, i)
    if prim_id < 0:
        add_light(radiance, pixel, weights, sky_toward(lights, dx, dy, dz), 1.0)
        return
    back = -dx / length, -dy / length, -dz / length
    u, v = gather(np.float32, hits.u, i), gather(np.float32, hits.v, i)
    point = surface_point(tables, prim_id, u, v, dx, dy, dz)
    lobes = lobes_at(tables, point)
    red, green, blue = times(lobes.diffuse, lights.ambient)
    if point.is_front:
        glow = emitted(tables, point)
        red, green, blue = red + glow[0], green + glow[1], blue + glow[2]
    for number in range(lights.light_count):
        found = arriving(tables, lights, number, point)
        if found.is_valid:
            color, _, _ = reflected(lobes, point, back, found.toward)
            red += color[0] * found.color[0]
            green += color[1] * found.color[1]
            blue += color[2] * found.color[2]
    add_light(radiance, pixel, weights, (red, green, blue), 1.0)


@kernel
def light_unblocked(paths, hits, tables, lights, first_pixel, radiance):
    """Light the surfaces that rays meet by every light, as if nothing were in its way.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`.
    lights : ClassicLights
    """
    places, found, base = addresses_of(paths), hits_at(hits), address(radiance)
    for i in range(np.uint64(len(paths.pixels))):
        light_first(i, places, found, tables, lights, first_pixel, base)


@device
def view_first(i, paths, hits, tables, lights, first_pixel, radiance):
    """Show the surface that ray i meets in grey; see `light_first` and `shade_by_view`."""
    pixel, weights = gather(np.int64, paths.pixels, i) - first_pixel, weights_of(paths, i)
    dx, dy, dz, length = direction_of(paths, i)
    prim_id = gather(np.int32, hits.prim_id, i)
    if prim_id < 0:
        add_light(radiance, pixel, weights, sky_toward(lights, dx, dy, dz), 1.0)
        return
    u, v = gather(np.float32, hits.u, i), gather(np.float32, hits.v, i)
    point = surface_point(tables, prim_id, u, v, dx, dy, dz)
    cosine = abs(dot((point.nx, point.ny, point.nz), (dx, dy, dz))) / length
    add_light(radiance, pixel, weights, (cosine, cosine, cosine), 1.0)


@kernel
def shade_by_view(paths, hits, tables, lights, first_pixel, radiance):
    """Show the surfaces that rays meet in grey, by the cosine between normal and view.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`.
    lights : ClassicLights
        Their sky is what rays that miss see.
    """
    places, found, base = addresses_of(paths), hits_at(hits), address(radiance)
    for i in range(np.uint64(len(paths.pixels))):
        view_first(i, places, found, tables, lights, first_pixel, base)
