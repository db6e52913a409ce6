"""Rays from surfaces into the directions that they face, as densely as ambient light comes."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device_call, kernel
from raystream.render.sampling.sampler import draw_pair
from raystream.render.sampling.warp import cosine_hemisphere, to_world
from raystream.render.shading.points import spawned, surface_point
from raystream.render.shading.streams import direction_of, put_ray

__all__ = ["look_around"]

#: The numbers before are for the place in the pixel and on the lens.
_DIMENSION = 4

_ONE = np.uint64(1)


@device_call
def _direction(sampler, pixel, sample, nx, ny, nz):
    u, v = draw_pair(sampler, pixel, sample, _DIMENSION)
    x, y, z = cosine_hemisphere(u, v)
    x, y, z = to_world(x, y, z, np.float32(nx), np.float32(ny), np.float32(nz))
    return np.float64(x), np.float64(y), np.float64(z)


@kernel
def look_around(paths, hits, tables, sampler, sample, count, distance, first_pixel, radiance, rays):
    """Send rays from the surfaces that paths meet.

    Parameters
    ----------
    paths, hits, tables, sampler, sample, first_pixel, radiance
        See `paths.follow_paths`. Paths that miss see white.
    count : int
        Rays from each point.
    distance : float
        Their length, world space; inf for all of the scene.
    rays : LightRays
        Room for `count` for each path; written. Each brings its share of white.

    Returns
    -------
    int
        Rays written.
    """
    _, us, vs, prim_ids = hits
    row = np.uint64(0)
    for i in range(np.uint64(len(paths.pixels))):
        pixel_id = paths.pixels[i]
        if prim_ids[i] < 0:
            for k in range(3):
                radiance[np.uint64(pixel_id - first_pixel), k] += paths.weights[i, k]
            continue
        dx, dy, dz, _ = direction_of(paths, i)
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
        share = np.float32(count)
        light = (
            paths.weights[i, 0] / share,
            paths.weights[i, 1] / share,
            paths.weights[i, 2] / share,
        )
        for j in range(count):
            toward = _direction(sampler, pixel_id, sample * count + j, point.nx, point.ny, point.nz)
            # Those that a smooth normal sends below the triangle meet it at once.
            if toward[0] * point.gx + toward[1] * point.gy + toward[2] * point.gz <= 0.0:
                continue
            origin, reach = spawned(tables, point, toward), np.float32(distance)
            put_ray(rays, row, pixel_id, origin, toward, reach, light)
            row += _ONE
    return np.int64(row)
