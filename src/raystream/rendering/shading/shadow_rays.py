"""Shadow rays: made from points toward lights, and their light added where nothing blocks them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32, ONE_F32
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, as_int32, f32x16, gather, load, narrow, select
from raystream.rendering.shading.rows import vector_at
from raystream.rendering.shading.streams import (
    add_light,
    addresses_of,
    append_rows,
    empty_columns,
    put_row,
)
from raystream.rendering.shading.surface_points import spawn_origin, world_position

_CLEAR, _WHITE = np.uint8(0), (1.0, 1.0, 1.0)


class ShadowRays(NamedTuple):
    """A stream of rays toward lights, with the light that arrives if nothing blocks them.

    Attributes
    ----------
    pixels : ndarray of shape (N,), int64
    origins : ndarray of shape (N, 3), float64
        World space.
    directions : ndarray of shape (N, 3), float32
    light : ndarray of shape (N, 3), float32
    t_max : ndarray of shape (N,), float32
    """

    pixels: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float32]
    light: NDArray[np.float32]
    t_max: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> ShadowRays:
        """Allocate `count` rows, with slack."""
        return cls._make(empty_columns(count))

    def first(self, count: int) -> ShadowRays:
        """The first `count` rows, shared."""
        return ShadowRays._make(array[:count] for array in self)


@device
def put_shadow_ray(rays, pixel, tables, point, found, light):
    """Write a ray from a point to a light; returns the cursor behind it.

    Parameters
    ----------
    rays : StreamCursor
        Of `ShadowRays`.
    pixel : int64
    tables : SceneTables
    point : Point
    found : LightSample
    light : tuple of three float64
        Added to the pixel if nothing blocks the ray.
    """
    x, y, z = spawn_origin(tables, point, found.toward)
    toward, t_max = found.toward, INF_F32
    if not found.is_far:
        px, py, pz = world_position(tables, found.target[0], found.target[1], found.target[2])
        toward, t_max = (px - x, py - y, pz - z), ONE_F32
    return put_row(rays, pixel, (x, y, z), toward, light, t_max)


@device
def put_shadow_rays(rays, mask, pixels, tables, point, found, light):
    """Write rays from points to lights without gaps; returns the cursor behind them.

    Parameters
    ----------
    rays : StreamCursor
        Of `ShadowRays` with slack.
    mask : mask16
    pixels : i64x16
    tables : SceneTables
    point : Point
    found : LightSample
    light : tuple of three f32x16
        Added to the pixels if nothing blocks the rays.
    """
    x, y, z = spawn_origin(tables, point, found.toward)
    px, py, pz = world_position(tables, found.target[0], found.target[1], found.target[2])
    toward = (
        select(found.is_far, found.toward[0], narrow(px - x)),
        select(found.is_far, found.toward[1], narrow(py - y)),
        select(found.is_far, found.toward[2], narrow(pz - z)),
    )
    t_max = select(found.is_far, INF_F32, f32x16(ONE_F32))
    return append_rows(rays, mask, pixels, (x, y, z), toward, light, t_max)


@device
def add_if_unblocked(i, rays, blocked, first_pixel, radiance):
    """Add the light of shadow ray i, unless it is blocked.

    Parameters
    ----------
    i : uint64
    rays : StreamAddresses
        Of `ShadowRays`.
    blocked : uint64
        Address of a byte per ray; 0 where nothing blocks it.
    first_pixel : int
        The pixel of row 0 of the light.
    radiance : uint64
        Address of shape (P, 3), float32.
    """
    if load(np.uint8, blocked + i) == _CLEAR:
        pixel = gather(np.int64, rays.pixels, i) - first_pixel
        add_light(radiance, pixel, vector_at(rays.colors, as_int32(i)), _WHITE, 1.0)


@kernel
def add_unblocked(rays, blocked, first_pixel, radiance):
    """Add the light of shadow rays that nothing blocks.

    Parameters
    ----------
    rays : ShadowRays
    blocked : ndarray of shape (N,), bool
    first_pixel : int
        The pixel of row 0 of `radiance`.
    radiance : ndarray of shape (P, 3), float32
        Changed.
    """
    stream, answers, base = addresses_of(rays), address(blocked), address(radiance)
    for i in range(np.uint64(len(rays.pixels))):
        add_if_unblocked(i, stream, answers, first_pixel, base)
