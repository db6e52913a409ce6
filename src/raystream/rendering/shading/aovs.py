"""What rays from the eye see first: the numbers of a picture's layers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.rendering.shading.bsdf import lobes_at
from raystream.rendering.shading.points import surface_point
from raystream.rendering.shading.streams import addresses_of, direction_of

__all__ = ["AovBuffers", "write_aovs"]


class AovBuffers(NamedTuple):
    """The first surface of one sample of each of P pixels.

    Attributes
    ----------
    depth : ndarray of shape (P,), float32
        Distance along the ray, from the eye or the lens, in scene units; inf where nothing is
        met.
    normal : ndarray of shape (P, 3), float32
        Unit shading normal in world space, on the side that is seen; NaN where nothing is met.
    albedo : ndarray of shape (P, 3), float32
        What part of light is scattered, evenly or as gloss, linear RGB; NaN where nothing is
        met. What is mirrored or let through shows other surfaces' colours, not this one's.
    prim_id : ndarray of shape (P,), int32
        -1 where nothing is met.
    emission : ndarray of shape (P, 3), float32
        What comes straight from the surface or, where nothing is met, from the background,
        linear RGB: all that the first stage which shades adds, before any further ray.
    """

    depth: NDArray[np.float32]
    normal: NDArray[np.float32]
    albedo: NDArray[np.float32]
    prim_id: NDArray[np.int32]
    emission: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> AovBuffers:
        """Room for so many pixels."""
        normal, albedo, emission = (np.empty((count, 3), np.float32) for _ in range(3))
        depth, prim_id = np.empty(count, np.float32), np.empty(count, np.int32)
        return cls(depth, normal, albedo, prim_id, emission)

    def part(self, begin: int, end: int) -> AovBuffers:
        """Some of the pixels; they are shared."""
        depth, normal, albedo, prim_id, emission = self
        part = slice(begin, end)
        return AovBuffers(depth[part], normal[part], albedo[part], prim_id[part], emission[part])


@kernel
def write_aovs(paths, hits, tables, first_pixel, seen):
    """Say what rays from the eye meet.

    Parameters
    ----------
    paths, hits, tables, first_pixel
        See `ShadingBatch`.
    seen : AovBuffers
        Written, for the pixels of all paths; all but `emission`.
    """
    ts, us, vs, prim_ids = hits
    places = addresses_of(paths)
    for i in range(np.uint64(len(paths.pixels))):
        pixel = np.uint64(paths.pixels[i] - first_pixel)
        seen.prim_id[pixel] = prim_ids[i]
        if prim_ids[i] < 0:
            seen.depth[pixel] = np.float32(np.inf)
            for k in range(3):
                seen.normal[pixel, k] = np.float32(np.nan)
                seen.albedo[pixel, k] = np.float32(np.nan)
            continue
        dx, dy, dz, length = direction_of(places, i)
        point = surface_point(tables, prim_ids[i], us[i], vs[i], dx, dy, dz)
        lobes = lobes_at(tables, point)
        seen.depth[pixel] = np.float32(np.float64(ts[i]) * length)
        seen.normal[pixel, 0] = np.float32(point.nx)
        seen.normal[pixel, 1] = np.float32(point.ny)
        seen.normal[pixel, 2] = np.float32(point.nz)
        for k in range(3):
            seen.albedo[pixel, k] = np.float32(min(lobes.diffuse[k] + lobes.specular[k], 1.0))
