"""Shading of the first surface alone: by lights that nothing blocks, and by the view."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.render.shading.bsdf import emitted, lobes_at, reflected
from raystream.render.shading.classic import arriving
from raystream.render.shading.points import surface_point
from raystream.render.shading.sky import sky_toward
from raystream.render.shading.streams import add_light, direction_of
from raystream.render.shading.vectors import dot, times

__all__ = ["light_unblocked", "shade_by_view"]


@kernel
def light_unblocked(paths, hits, tables, lights, first_pixel, radiance):
    """Light the surfaces that rays meet by every light, as if nothing were in its way.

    Parameters
    ----------
    paths, hits, tables, first_pixel, radiance
        See `paths.follow_paths`.
    lights : ClassicLights
    """
    _, us, vs, prim_ids = hits
    for i in range(np.uint64(len(paths.pixels))):
        pixel = np.uint64(paths.pixels[i] - first_pixel)
        dx, dy, dz, length = direction_of(paths, i)
        if prim_ids[i] < 0:
            add_light(radiance, pixel, paths.weights, i, sky_toward(lights, dx, dy, dz), 1.0)
            continue
        back = -dx / length, -dy / length, -dz / length
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
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
        add_light(radiance, pixel, paths.weights, i, (red, green, blue), 1.0)


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
    _, us, vs, prim_ids = hits
    for i in range(np.uint64(len(paths.pixels))):
        pixel = np.uint64(paths.pixels[i] - first_pixel)
        dx, dy, dz, length = direction_of(paths, i)
        if prim_ids[i] < 0:
            add_light(radiance, pixel, paths.weights, i, sky_toward(lights, dx, dy, dz), 1.0)
            continue
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
        cosine = abs(dot((point.nx, point.ny, point.nz), (dx, dy, dz))) / length
        add_light(radiance, pixel, paths.weights, i, (cosine, cosine, cosine), 1.0)
