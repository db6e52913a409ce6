"""AOVs: depth, normal, albedo, triangle and emission at the first hits of camera rays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.rendering.shading.bsdf import diffuse_albedo, glossy_albedo, lobes_at
from raystream.rendering.shading.streams import addresses_of, direction_of
from raystream.rendering.shading.surface_points import surface_point
from raystream.rendering.shading.vectors import added


class AovBuffers(NamedTuple):
    """The first hit of one sample of each of P pixels.

    Attributes
    ----------
    depth : ndarray of shape (P,), float32
        Distance along the ray, from the camera or the lens, in scene units; inf for a miss.
    normal : ndarray of shape (P, 3), float32
        Unit shading normal in world space, facing the camera; NaN for a miss.
    albedo : ndarray of shape (P, 3), float32
        Diffuse and glossy reflectance, linear RGB; NaN for a miss. Mirror reflection and
        transmission are left out: they show the colours of other surfaces.
    prim_id : ndarray of shape (P,), int32
        -1 for a miss.
    emission : ndarray of shape (P, 3), float32
        Light of the surface itself or, for a miss, of the background, linear RGB: all that the
        first shading stage adds, before any secondary ray.
    """

    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    albedo: NDArray[np.float32]
    prim_id: NDArray[np.int32]
    emission: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> AovBuffers:
        """Allocate buffers for `count` pixels."""
        normal, albedo, emission = (np.empty((count, 3), np.float32) for _ in range(3))
        depth, prim_id = np.empty(count, np.float32), np.empty(count, np.int32)
        return cls(depth, normal, albedo, prim_id, emission)

    def part(self, begin: int, end: int) -> AovBuffers:
        """A view of some of the pixels."""
        depth, normal, albedo, prim_id, emission = self
        part = slice(begin, end)
        return AovBuffers(depth[part], normal[part], albedo[part], prim_id[part], emission[part])


@kernel
def write_aovs(batch, tables, aovs):
    """Write the first hits of camera rays.

    Parameters
    ----------
    batch : ShadingBatch
        No light is added.
    tables : SceneTables
    aovs : AovBuffers
        Written, for the pixels of all paths; all but `emission`.
    """
    ts, us, vs, prim_ids = batch.hits
    pixels, paths = batch.paths.pixels, addresses_of(batch.paths)
    for i in range(np.uint64(batch.path_count)):
        pixel = np.uint64(pixels[i] - batch.first_pixel)
        aovs.prim_id[pixel] = prim_ids[i]
        if prim_ids[i] < 0:
            aovs.depth[pixel] = np.float32(np.inf)
            for k in range(3):
                aovs.normal[pixel, k] = np.float32(np.nan)
                aovs.albedo[pixel, k] = np.float32(np.nan)
            continue
        dx, dy, dz, length = direction_of(paths, i)
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
        back = -dx / length, -dy / length, -dz / length
        lobes = lobes_at(tables, point, back)
        albedo = added(diffuse_albedo(lobes), glossy_albedo(lobes), 1.0)
        aovs.depth[pixel] = np.float32(np.float64(ts[i]) * length)
        aovs.normal[pixel, 0] = np.float32(point.nx)
        aovs.normal[pixel, 1] = np.float32(point.ny)
        aovs.normal[pixel, 2] = np.float32(point.nz)
        for k in range(3):
            aovs.albedo[pixel, k] = np.float32(min(albedo[k], 1.0))
