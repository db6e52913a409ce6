"""Compositing all hits of a ray as thin transparent sheets, front to back."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.rendering.shading.bsdf import lobes_at
from raystream.rendering.shading.sky import sky_radiance
from raystream.rendering.shading.streams import add_light, addresses_of, direction_of, weights_of
from raystream.rendering.shading.surface_points import surface_point


@kernel
def composite_hits(paths, splits, rows, tables, opacity, lights, first_pixel, radiance):
    """Composite all surfaces along each ray, front to back.

    Parameters
    ----------
    paths, first_pixel, radiance
        See `ShadingBatch`.
    tables : SceneTables
    splits, rows : ndarray of shape (N + 1,), int64, and tuple of u, v, prim_id
        All hits of the rays, as in `MultiHits`.
    opacity : float
        Of a sheet at normal incidence, 0 to 1; it increases with the angle.
    lights : PunctualLights
        Their sky is behind all sheets.
    """
    us, vs, prim_ids = rows
    clear, places, base = 1.0 - opacity, addresses_of(paths), address(radiance)
    for i in range(np.uint64(len(paths.pixels))):
        pixel = np.uint64(paths.pixels[i] - first_pixel)
        dx, dy, dz, length = direction_of(places, i)
        weights = weights_of(places, i)
        passed = 1.0
        for row in range(np.uint64(splits[i]), np.uint64(splits[i + ONE_U64])):
            point = surface_point(tables, prim_ids[row], us[row], vs[row], dx, dy, dz)
            cosine = abs(point.gx * dx + point.gy * dy + point.gz * dz) / length
            facing = abs(point.nx * dx + point.ny * dy + point.nz * dz) / length
            here = clear ** (1.0 / cosine) if cosine > 0.0 else 0.0
            back = -dx / length, -dy / length, -dz / length
            color = lobes_at(tables, point, back).diffuse
            shade = passed * (1.0 - here) * facing
            add_light(base, pixel, weights, color, shade)
            passed *= here
        behind = sky_radiance(lights, dx, dy, dz)
        add_light(base, pixel, weights, behind, passed)
