"""Rays of ambient occlusion: cosine-distributed around the normals of first hits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    as_int32,
    as_uint32,
    f32x16,
    f64x16,
    gather,
    i32x16,
    i64x16,
    lane_count,
    lane_numbers,
    u32x16,
    widen,
)
from raystream.rendering.sampling.sampler import draw_pair_lanes
from raystream.rendering.sampling.warp import cosine_hemisphere, to_world
from raystream.rendering.shading.streams import (
    StreamCursor,
    addresses_of,
    append_rows,
    batch_addresses,
    direction_of,
    weights_of,
)
from raystream.rendering.shading.surface_points import surface_point, world_position

#: The first sampler dimension: those before are for the position in the pixel and on the lens.
_DIMENSION = 4


class OcclusionOptions(NamedTuple):
    """Number and length of the rays.

    Attributes
    ----------
    ray_count : int
        Per hit.
    distance : float
        Their length, world space; inf for unlimited.
    """

    ray_count: int
    distance: float


@device
def _spread(a):
    """A vector of three float64 in all lanes, float32."""
    return f32x16(np.float32(a[0])), f32x16(np.float32(a[1])), f32x16(np.float32(a[2]))


@device
def spawn_path_ao_rays(i, batch, tables, sample, options, rays):
    """Spawn rays from the hit of path i.

    Parameters
    ----------
    i : uint64
    batch : ShadingBatch
        Of addresses.
    tables, sample, options
        See `spawn_ao_rays`.
    rays : StreamCursor
        Of `ShadowRays`.

    Returns
    -------
    StreamCursor
        Behind the rows written.
    """
    paths, hits, count = batch.paths, batch.hits, options.ray_count
    pixel_id, weights = gather(np.int64, paths.pixels, i), weights_of(paths, i)
    prim_id = gather(np.int32, hits.prim_id, i)
    if prim_id < 0:
        return rays
    dx, dy, dz, _ = direction_of(paths, i)
    across, up = gather(np.float32, hits.u, i), gather(np.float32, hits.v, i)
    point = surface_point(tables, prim_id, across, up, dx, dy, dz)
    share, reach = np.float64(1.0 / count), f32x16(np.float32(options.distance))
    light = _spread((weights[0] * share, weights[1] * share, weights[2] * share))
    normal = _spread((point.nx, point.ny, point.nz))
    # All start at one point, on the side of the camera.
    origin = world_position(
        tables,
        point.x + point.offset * point.gx,
        point.y + point.offset * point.gy,
        point.z + point.offset * point.gz,
    )
    lanes = lane_numbers(i32x16)
    first_sample = as_uint32(sample.number * count)
    for first in range(0, count, lane_count(lanes)):
        j = lanes + as_int32(first)
        samples = as_uint32(j) + first_sample
        u, v = draw_pair_lanes(sample.sampler, u32x16(as_uint32(pixel_id)), samples, _DIMENSION)
        x, y, z = to_world(*cosine_hemisphere(u, v), *normal)
        # Those that a smooth normal sends below the triangle hit it at once.
        height = widen(x) * point.gx + widen(y) * point.gy + widen(z) * point.gz
        mask = (j < as_int32(count)) & (height > 0.0)
        start = f64x16(origin[0]), f64x16(origin[1]), f64x16(origin[2])
        rays = append_rows(rays, mask, i64x16(pixel_id), start, (x, y, z), light, reach)
    return rays


@kernel
def spawn_ao_rays(batch, tables, sample, options, rays):
    """Spawn rays from the hits of paths.

    Parameters
    ----------
    batch : ShadingBatch
        Paths that miss stay black.
    tables : SceneTables
    sample : PixelSample
    options : OcclusionOptions
    rays : ShadowRays
        Room for all of each path, with slack; written. Each brings its share of white.

    Returns
    -------
    int
        Rays written.
    """
    places = batch_addresses(batch)
    ray_end = StreamCursor(addresses_of(rays), np.uint64(0))
    for i in range(np.uint64(batch.path_count)):
        ray_end = spawn_path_ao_rays(i, places, tables, sample, options, ray_end)
    return np.int64(ray_end.row)
