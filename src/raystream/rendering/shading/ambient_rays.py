"""Rays from surfaces into the directions that they face, as densely as ambient light comes."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    as_int32,
    as_uint32,
    f32x16,
    f64x16,
    gather,
    i32x16,
    i64x16,
    lane_count,
    lane_numbers,
    mask_bits,
    popcount,
    u32x16,
    widen,
)
from raystream.rendering.sampling.sampler import draw_pair_lanes
from raystream.rendering.sampling.warp import cosine_hemisphere, to_world
from raystream.rendering.shading.points import surface_point, world_place
from raystream.rendering.shading.rows import (
    append_numbers,
    append_pixels,
    append_places,
    append_vectors,
)
from raystream.rendering.shading.streams import (
    add_light,
    addresses_of,
    direction_of,
    hits_at,
    weights_of,
)

__all__ = ["look_from", "sample_ambient"]

#: The numbers before are for the place in the pixel and on the lens.
_DIMENSION = 4

_WHITE = (1.0, 1.0, 1.0)


@device
def _spread(a):
    """A vector of three float64 in all lanes, float32."""
    return f32x16(np.float32(a[0])), f32x16(np.float32(a[1])), f32x16(np.float32(a[2]))


@device
def look_from(
    i,
    paths,
    hits,
    tables,
    sampler,
    sample,
    count,
    distance,
    first_pixel,
    radiance,
    rays,
    row,
):
    """Send rays from the surface that path i meets.

    Parameters
    ----------
    i : uint64
    paths, rays : StreamAddresses
    hits : HitAddresses
    tables, sampler, sample, count, distance, first_pixel
        See `sample_ambient`.
    radiance : uint64
        Address of the pixels' light.
    row : uint64
        Where the rays go.

    Returns
    -------
    uint64
        The row behind them.
    """
    pixel_id, weights = gather(np.int64, paths.pixels, i), weights_of(paths, i)
    prim_id = gather(np.int32, hits.prim_id, i)
    if prim_id < 0:
        add_light(radiance, pixel_id - first_pixel, weights, _WHITE, 1.0)
        return row
    dx, dy, dz, _ = direction_of(paths, i)
    across, up = gather(np.float32, hits.u, i), gather(np.float32, hits.v, i)
    point = surface_point(tables, prim_id, across, up, dx, dy, dz)
    share, reach = np.float64(1.0 / count), f32x16(np.float32(distance))
    light = _spread((weights[0] * share, weights[1] * share, weights[2] * share))
    normal = _spread((point.nx, point.ny, point.nz))
    # All leave on the side of the view, from one place.
    origin = world_place(
        tables,
        point.x + point.offset * point.gx,
        point.y + point.offset * point.gy,
        point.z + point.offset * point.gz,
    )
    lanes = lane_numbers(i32x16)
    for first in range(0, count, lane_count(lanes)):
        j = lanes + as_int32(first)
        samples = as_uint32(j) + as_uint32(sample * count)
        u, v = draw_pair_lanes(sampler, u32x16(as_uint32(pixel_id)), samples, _DIMENSION)
        x, y, z = to_world(*cosine_hemisphere(u, v), *normal)
        # Those that a smooth normal sends below the triangle meet it at once.
        height = widen(x) * point.gx + widen(y) * point.gy + widen(z) * point.gz
        mask = (j < as_int32(count)) & (height > 0.0)
        append_pixels(rays.pixels, row, i64x16(pixel_id), mask)
        append_numbers(rays.numbers, row, reach, mask)
        start = f64x16(origin[0]), f64x16(origin[1]), f64x16(origin[2])
        append_places(rays.origins, row, start, mask)
        append_vectors(rays.directions, row, (x, y, z), mask)
        append_vectors(rays.colors, row, light, mask)
        row += popcount(mask_bits(mask))
    return row


@kernel
def sample_ambient(
    paths, hits, tables, sampler, sample, count, distance, first_pixel, radiance, rays
):
    """Send rays from the surfaces that paths meet.

    Parameters
    ----------
    paths, hits, tables, sampler, sample, first_pixel, radiance
        See `paths.follow_paths`. Paths that miss see white.
    count : int
        Rays from each point.
    distance : float
        Their length, world space; inf for all of the scene.
    rays : ShadowRays
        Room for `count` for each path, with slack; written. Each brings its share of white.

    Returns
    -------
    int
        Rays written.
    """
    row = np.uint64(0)
    for i in range(np.uint64(len(paths.pixels))):
        row = look_from(
            i,
            addresses_of(paths),
            hits_at(hits),
            tables,
            sampler,
            sample,
            count,
            distance,
            first_pixel,
            address(radiance),
            addresses_of(rays),
            row,
        )
    return np.int64(row)
