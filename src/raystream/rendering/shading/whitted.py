"""Whitted's shading: light from each light, and rays on to mirrors and through glass.

References
----------
Whitted, "An Improved Illumination Model for Shaded Display", 1980. Without recursion: what a
ray brings to its pixel is in its weight (Purcell 2002, section 3.2; Christen 2005, section
5.2, whose equation 5.1 this is, with a material's colour times 1 - r as its diffuse share).
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, gather
from raystream.rendering.shading.absorption import left_of
from raystream.rendering.shading.bsdf import emitted, fresnel, lobes_at, reflected, refracted
from raystream.rendering.shading.points import surface_point
from raystream.rendering.shading.punctual_lights import arriving
from raystream.rendering.shading.sky import sky_toward
from raystream.rendering.shading.streams import (
    add_light,
    addresses_of,
    aimed,
    direction_of,
    hits_at,
    put_path,
    put_ray,
    weights_of,
)
from raystream.rendering.shading.tables import ABSORBS
from raystream.rendering.shading.vectors import added, dot, mirrored, scaled, times

__all__ = ["light_surface", "light_surfaces"]

_ONE = np.uint64(1)


@device
def _go_on(onward, row, pixel, tables, point, toward, weights, color, min_weight):
    """Write a ray that goes on, unless it brings too little; returns the next free row."""
    weight = weights[0] * color[0], weights[1] * color[1], weights[2] * color[2]
    if not max(weight[0], weight[1], weight[2]) > min_weight:
        return row
    put_path(onward, row, pixel, tables, point, toward, weight, np.inf)
    return row + _ONE


@device
def _ask_lights(rays, row, pixel, tables, lights, lobes, point, back, weights):
    """Write a ray to each light that a surface faces; returns the next free row."""
    for number in range(lights.light_count):
        found = arriving(tables, lights, number, point)
        if not found.is_valid:
            continue
        color, _, _ = reflected(lobes, point, back, found.toward)
        if color[0] + color[1] + color[2] <= 0.0:
            continue
        light = (
            weights[0] * color[0] * found.color[0],
            weights[1] * color[1] * found.color[1],
            weights[2] * color[2] * found.color[2],
        )
        origin, toward, t_max = aimed(tables, point, found)
        put_ray(rays, row, pixel, origin, toward, t_max, light)
        row += _ONE
    return row


@device
def light_surface(
    i,
    paths,
    hits,
    tables,
    lights,
    goes_on,
    min_weight,
    first_pixel,
    radiance,
    onward,
    path_row,
    rays,
    ray_row,
):
    """Light the surface that ray i meets, and send rays on.

    Parameters
    ----------
    i : uint64
    paths, onward, rays : StreamAddresses
    hits : HitAddresses
    tables, lights, goes_on, min_weight, first_pixel
        See `light_surfaces`.
    radiance : uint64
        Address of the pixels' light.
    path_row, ray_row : uint64
        Where those go that are written.

    Returns
    -------
    path_row, ray_row : uint64
        Behind those.
    """
    pixel_id, weights = gather(np.int64, paths.pixels, i), weights_of(paths, i)
    pixel = pixel_id - first_pixel
    dx, dy, dz, length = direction_of(paths, i)
    prim_id = gather(np.int32, hits.prim_id, i)
    if prim_id < 0:
        add_light(radiance, pixel, weights, sky_toward(lights, dx, dy, dz), 1.0)
        return path_row, ray_row
    back = -dx / length, -dy / length, -dz / length
    u, v = gather(np.float32, hits.u, i), gather(np.float32, hits.v, i)
    point = surface_point(tables, prim_id, u, v, dx, dy, dz)
    if point.is_front:
        add_light(radiance, pixel, weights, emitted(tables, point), 1.0)
    elif tables.kinds & ABSORBS:
        left = left_of(tables, point, gather(np.float32, hits.t, i) * length)
        weights = (
            weights[0] * np.float32(left[0]),
            weights[1] * np.float32(left[1]),
            weights[2] * np.float32(left[2]),
        )
    lobes = lobes_at(tables, point)
    add_light(radiance, pixel, weights, times(lobes.diffuse, lights.ambient), 1.0)
    ray_row = _ask_lights(rays, ray_row, pixel_id, tables, lights, lobes, point, back, weights)
    if not goes_on:
        return path_row, ray_row

    normal, clear = (point.nx, point.ny, point.nz), 0.0
    through = lobes.transmission
    if through[0] + through[1] + through[2] > 0.0:
        if lobes.ior != 1.0:
            clear = fresnel(min(dot(back, normal), 1.0), lobes.ior)
        toward = refracted(back, normal, lobes.ior)
        if clear < 1.0 and dot((point.gx, point.gy, point.gz), toward) < 0.0:
            color = scaled(through, 1.0 - clear)
            path_row = _go_on(
                onward, path_row, pixel_id, tables, point, toward, weights, color, min_weight
            )
    color = added(lobes.reflection, through, clear)
    toward = mirrored(back, normal)
    if dot((point.gx, point.gy, point.gz), toward) > 0.0:
        path_row = _go_on(
            onward, path_row, pixel_id, tables, point, toward, weights, color, min_weight
        )
    return path_row, ray_row


@kernel
def light_surfaces(
    paths, hits, tables, lights, goes_on, min_weight, first_pixel, radiance, onward, rays
):
    """Light the surfaces that rays meet, by every light, and send rays on.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`. What surfaces emit, and ambient light, is added at once.
    lights : PunctualLights
    goes_on : bool
        Whether mirrors and glass send rays on.
    min_weight : float
        Rays of which no colour weighs more end.
    onward : Paths
        Room for twice as many; reflected and refracted rays are written.
    rays : ShadowRays
        Room for one to each light for each ray; written.

    Returns
    -------
    path_count, ray_count : int
        Rows written.
    """
    path_count, ray_count = np.uint64(0), np.uint64(0)
    for i in range(np.uint64(len(paths.pixels))):
        path_count, ray_count = light_surface(
            i,
            addresses_of(paths),
            hits_at(hits),
            tables,
            lights,
            goes_on,
            min_weight,
            first_pixel,
            address(radiance),
            addresses_of(onward),
            path_count,
            addresses_of(rays),
            ray_count,
        )
    return np.int64(path_count), np.int64(ray_count)
