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
from raystream.render.shading.absorption import left_of
from raystream.render.shading.bsdf import emitted, fresnel, lobes_at, reflected, refracted
from raystream.render.shading.classic import arriving
from raystream.render.shading.points import surface_point
from raystream.render.shading.sky import sky_toward
from raystream.render.shading.streams import add_light, aimed, direction_of, put_path, put_ray
from raystream.render.shading.tables import ABSORBS
from raystream.render.shading.vectors import added, dot, mirrored, scaled, times

__all__ = ["light_surfaces"]

_ONE = np.uint64(1)


@device
def _go_on(onward, row, pixel, tables, point, toward, weights, i, color, min_weight):
    """Write a ray that goes on, unless it brings too little; returns the next free row."""
    weight = (
        weights[i, 0] * color[0],
        weights[i, 1] * color[1],
        weights[i, 2] * color[2],
    )
    if not max(weight[0], weight[1], weight[2]) > min_weight:
        return row
    put_path(onward, row, pixel, tables, point, toward, weight, np.inf)
    return row + _ONE


@kernel
def light_surfaces(
    paths, hits, tables, lights, goes_on, min_weight, first_pixel, radiance, onward, rays
):
    """Light the surfaces that rays meet, by every light, and send rays on.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`. What surfaces emit, and ambient light, is added at once. The
        paths' weights become less where their rays were inside of what absorbs.
    lights : ClassicLights
    goes_on : bool
        Whether mirrors and glass send rays on.
    min_weight : float
        Rays of which no colour weighs more end.
    onward : Paths
        Room for twice as many; reflected and refracted rays are written.
    rays : LightRays
        Room for one to each light for each ray; written.

    Returns
    -------
    path_count, ray_count : int
        Rows written.
    """
    ts, us, vs, prim_ids = hits
    path_count, ray_count = np.uint64(0), np.uint64(0)
    for i in range(np.uint64(len(paths.pixels))):
        pixel_id = paths.pixels[i]
        pixel = np.uint64(pixel_id - first_pixel)
        dx, dy, dz, length = direction_of(paths, i)
        if prim_ids[i] < 0:
            add_light(radiance, pixel, paths.weights, i, sky_toward(lights, dx, dy, dz), 1.0)
            continue
        back = -dx / length, -dy / length, -dz / length
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
        if point.is_front:
            add_light(radiance, pixel, paths.weights, i, emitted(tables, point), 1.0)
        elif tables.kinds & ABSORBS:
            left = left_of(tables, point, ts[i] * length)
            for k in range(3):
                paths.weights[i, k] *= np.float32(left[k])
        lobes = lobes_at(tables, point)
        light = times(lobes.diffuse, lights.ambient)
        add_light(radiance, pixel, paths.weights, i, light, 1.0)
        for number in range(lights.light_count):
            found = arriving(tables, lights, number, point)
            if not found.is_valid:
                continue
            color, _, _ = reflected(lobes, point, back, found.toward)
            if color[0] + color[1] + color[2] <= 0.0:
                continue
            weights = paths.weights
            light = (
                weights[i, 0] * color[0] * found.color[0],
                weights[i, 1] * color[1] * found.color[1],
                weights[i, 2] * color[2] * found.color[2],
            )
            origin, toward, t_max = aimed(tables, point, found)
            put_ray(rays, ray_count, pixel_id, origin, toward, t_max, light)
            ray_count += _ONE
        if not goes_on:
            continue

        normal, clear = (point.nx, point.ny, point.nz), 0.0
        through = lobes.transmission
        if through[0] + through[1] + through[2] > 0.0:
            if lobes.ior != 1.0:
                clear = fresnel(min(dot(back, normal), 1.0), lobes.ior)
            toward = refracted(back, normal, lobes.ior)
            if clear < 1.0 and dot((point.gx, point.gy, point.gz), toward) < 0.0:
                color = scaled(through, 1.0 - clear)
                path_count = _go_on(
                    onward,
                    path_count,
                    pixel_id,
                    tables,
                    point,
                    toward,
                    paths.weights,
                    i,
                    color,
                    min_weight,
                )
        color = added(lobes.reflection, through, clear)
        toward = mirrored(back, normal)
        if dot((point.gx, point.gy, point.gz), toward) > 0.0:
            path_count = _go_on(
                onward,
                path_count,
                pixel_id,
                tables,
                point,
                toward,
                paths.weights,
                i,
                color,
                min_weight,
            )
    return np.int64(path_count), np.int64(ray_count)
