"""Whitted shading: shadow rays to every light, and rays continued by mirrors and glass.

References
----------
Whitted, "An Improved Illumination Model for Shaded Display", 1980. Without recursion: a ray's
weight holds its contribution to its pixel (Purcell 2002, section 3.2; Christen 2005, section
5.2, whose equation 5.1 this is, with a material's colour times 1 - r as its diffuse share).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import gather
from raystream.rendering.shading.absorption import transmittance
from raystream.rendering.shading.bsdf import (
    diffuse_albedo,
    emitted,
    eval_reflection,
    fresnel,
    gloss_share,
    lobes_at,
    reflected_surroundings,
    refracted,
)
from raystream.rendering.shading.plain_scenes import plain_copy
from raystream.rendering.shading.punctual_lights import incident_light
from raystream.rendering.shading.shadow_rays import put_shadow_ray
from raystream.rendering.shading.sky import sky_radiance
from raystream.rendering.shading.streams import (
    StreamCursor,
    add_light,
    addresses_of,
    batch_addresses,
    direction_of,
    put_row,
    weights_of,
)
from raystream.rendering.shading.surface_points import spawn_origin, surface_point
from raystream.rendering.shading.tables import ABSORBS, IS_ROUGH
from raystream.rendering.shading.vectors import added, dot, mirrored, scaled, times


class WhittedOptions(NamedTuple):
    """Options of Whitted ray tracing.

    Attributes
    ----------
    continues : bool
        Whether mirrors and glass continue paths.
    min_weight : float
        Paths end where no channel weighs more.
    casts_shadows : bool
        Whether light is added by shadow rays; if not, at once, as if nothing blocked it.
    """

    continues: bool
    min_weight: float
    casts_shadows: bool


@device
def _continue(onward, pixel, tables, point, toward, weights, color, min_weight):
    """Write the next ray of a path, unless it weighs too little; returns the cursor."""
    weight = times(weights, color)
    if not max(weight[0], weight[1], weight[2]) > min_weight:
        return onward
    origin = spawn_origin(tables, point, toward)
    return put_row(onward, pixel, origin, toward, weight, np.inf)


@device
def _sample_all_lights(rays, pixel, batch, tables, lights, surface, weights, shadows):
    """Add the light of each light that a surface faces, or write its shadow ray.

    `surface` is its point, lobes, and the unit vector to the ray's origin. Returns the cursor of
    shadow rays.
    """
    point, lobes, back = surface
    for number in range(lights.light_count):
        found = incident_light(tables, lights, number, point)
        if not found.is_valid:
            continue
        color, _ = eval_reflection(lobes, point, back, found.toward)
        if color[0] + color[1] + color[2] <= 0.0:
            continue
        if not shadows:
            row = pixel - batch.first_pixel
            add_light(batch.radiance, row, weights, times(color, found.color), 1.0)
            continue
        light = times(times(weights, color), found.color)
        rays = put_shadow_ray(rays, pixel, tables, point, found, light)
    return rays


@device
def shade_whitted_path(i, batch, tables, lights, options, onward, rays):
    """Shade path i at the surface that its ray hits.

    Parameters
    ----------
    i : uint64
    batch : ShadingBatch
        Of addresses.
    tables, lights, options
        See `shade_whitted`.
    onward, rays : StreamCursor
        Of `Paths` and `ShadowRays`.

    Returns
    -------
    onward, rays : StreamCursor
        Behind the rows written.
    """
    paths, hits, radiance = batch.paths, batch.hits, batch.radiance
    pixel_id, weights = gather(np.int64, paths.pixels, i), weights_of(paths, i)
    pixel = pixel_id - batch.first_pixel
    dx, dy, dz, length = direction_of(paths, i)
    prim_id = gather(np.int32, hits.prim_id, i)
    if prim_id < 0:
        add_light(radiance, pixel, weights, sky_radiance(lights, dx, dy, dz), 1.0)
        return onward, rays
    back = -dx / length, -dy / length, -dz / length
    u, v = gather(np.float32, hits.u, i), gather(np.float32, hits.v, i)
    point = surface_point(tables, prim_id, u, v, dx, dy, dz)
    if point.is_front:
        add_light(radiance, pixel, weights, emitted(tables, point), 1.0)
    elif tables.kinds & ABSORBS:
        left = transmittance(tables, point, gather(np.float32, hits.t, i) * length)
        weights = (
            weights[0] * np.float32(left[0]),
            weights[1] * np.float32(left[1]),
            weights[2] * np.float32(left[2]),
        )
    lobes = lobes_at(tables, point, back)
    add_light(radiance, pixel, weights, times(diffuse_albedo(lobes), lights.ambient), 1.0)
    if tables.kinds & IS_ROUGH:
        add_light(radiance, pixel, weights, reflected_surroundings(lobes, lights), 1.0)
    surface = point, lobes, back
    rays = _sample_all_lights(
        rays, pixel_id, batch, tables, lights, surface, weights, options.casts_shadows
    )
    if not options.continues:
        return onward, rays
    min_weight = options.min_weight

    normal, clear = (point.nx, point.ny, point.nz), 0.0
    below = (1.0 - gloss_share(lobes, back, normal)) * lobes.base
    through = scaled(lobes.transmission, below)
    if through[0] + through[1] + through[2] > 0.0:
        if lobes.ior != 1.0:
            clear = fresnel(min(dot(back, normal), 1.0), lobes.ior)
        toward = refracted(back, normal, lobes.ior)
        if clear < 1.0 and dot((point.gx, point.gy, point.gz), toward) < 0.0:
            color = scaled(through, 1.0 - clear)
            onward = _continue(onward, pixel_id, tables, point, toward, weights, color, min_weight)
    color = added(scaled(lobes.reflection, lobes.base), through, clear)
    toward = mirrored(back, normal)
    if dot((point.gx, point.gy, point.gz), toward) > 0.0:
        onward = _continue(onward, pixel_id, tables, point, toward, weights, color, min_weight)
    return onward, rays


@kernel
def shade_whitted(batch, tables, lights, options, onward, rays):
    """Shade paths at the surfaces that their rays hit, under every light.

    Parameters
    ----------
    batch : ShadingBatch
        Emitted and ambient light are added at once.
    tables : SceneTables
    lights : PunctualLights
    options : WhittedOptions
    onward : Paths
        Room for twice as many; reflected and refracted rays are written.
    rays : ShadowRays
        Room for one per light and path; written.

    Returns
    -------
    path_count, ray_count : int
        Rows written.
    """
    places = batch_addresses(batch)
    path_end = StreamCursor(addresses_of(onward), np.uint64(0))
    ray_end = StreamCursor(addresses_of(rays), np.uint64(0))
    for i in range(np.uint64(batch.path_count)):
        path_end, ray_end = shade_whitted_path(
            i, places, tables, lights, options, path_end, ray_end
        )
    return np.int64(path_end.row), np.int64(ray_end.row)


shade_plain_whitted = plain_copy(shade_whitted)
