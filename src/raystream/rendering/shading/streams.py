"""Streams that shading kernels read and write: paths, and rays to lights."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    as_int32,
    f32x16,
    gather,
    load,
    narrow,
    scatter,
    select,
)
from raystream.kernels.collect import HitAddresses
from raystream.rendering.shading.points import spawned, world_place
from raystream.rendering.shading.rows import (
    append_numbers,
    append_pixels,
    append_places,
    append_vectors,
    put_vectors,
    vector_at,
)

__all__ = [
    "SLACK",
    "Paths",
    "ShadowRays",
    "StreamAddresses",
    "add_if_unblocked",
    "add_light",
    "add_lights",
    "add_unblocked",
    "addresses_of",
    "aimed",
    "direction_of",
    "hits_at",
    "put_light_rays",
    "put_path",
    "put_paths",
    "put_ray",
    "weights_of",
]

_ONE, _INF = np.float32(1.0), np.float32(np.inf)
_CLEAR, _WHITE = np.uint8(0), (1.0, 1.0, 1.0)

#: Rows behind the last one of arrays that kernels write to: vectors that are written whole may
#: reach so far.
SLACK = 16


class Paths(NamedTuple):
    """A stream of paths, each at the start of a ray.

    Attributes
    ----------
    pixels : ndarray of shape (N,), int64
    origins : ndarray of shape (N, 3), float64
        World space.
    directions : ndarray of shape (N, 3), float32
    weights : ndarray of shape (N, 3), float32
        What part of the light that a ray finds reaches its pixel.
    pdfs : ndarray of shape (N,), float32
        Density over solid angle with which the direction was chosen; inf where no other way
        finds its light: from the eye, from mirrors and through glass.
    """

    pixels: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float32]
    weights: NDArray[np.float32]
    pdfs: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> Paths:
        """Room for so many, with slack."""
        return cls._make(_room(count))

    def first(self, count: int) -> Paths:
        """The first `count` of them."""
        return Paths._make(array[:count] for array in self)


class ShadowRays(NamedTuple):
    """Rays to lights, and what they bring if nothing is in their way.

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
        """Room for so many, with slack."""
        return cls._make(_room(count))

    def first(self, count: int) -> ShadowRays:
        """The first `count` of them."""
        return ShadowRays._make(array[:count] for array in self)


class StreamAddresses(NamedTuple):
    """Where the columns of a stream of either kind begin: of the first path or ray.

    Attributes
    ----------
    pixels, origins, directions, colors, numbers : uint64
        In the order of `Paths` and `ShadowRays`; colours are weights or light, numbers densities
        or ends.
    """

    pixels: np.uint64
    origins: np.uint64
    directions: np.uint64
    colors: np.uint64
    numbers: np.uint64


def _room(count: int) -> list[NDArray[Any]]:
    """Arrays of either kind of stream for so many rows, with slack behind them."""
    rows = count + SLACK
    pixels, origins = np.empty(rows, np.int64), np.empty((rows, 3))
    directions, colors = (np.empty((rows, 3), np.float32) for _ in range(2))
    numbers = np.empty(rows, np.float32)
    return [array[:count] for array in (pixels, origins, directions, colors, numbers)]


@device
def addresses_of(stream):
    """Where a stream's columns begin, `Paths` or `ShadowRays`."""
    pixels, origins, directions, colors, numbers = stream
    return StreamAddresses(
        address(pixels), address(origins), address(directions), address(colors), address(numbers)
    )


@device
def hits_at(hits):
    """Where hits begin, of a tuple of contiguous arrays t, u, v and prim_id."""
    ts, us, vs, prim_ids = hits
    return HitAddresses(address(ts), address(us), address(vs), address(prim_ids))


@device
def weights_of(paths, i):
    """Weights of path i of a stream, by its addresses, three float32."""
    return vector_at(paths.colors, as_int32(i))


@device
def direction_of(paths, i):
    """Direction of path i of a stream, by its addresses, and its length, float64."""
    x, y, z = vector_at(paths.directions, as_int32(i))
    x, y, z = np.float64(x), np.float64(y), np.float64(z)
    return x, y, z, math.sqrt(x * x + y * y + z * z)


@device
def put_path(onward, row, pixel, tables, point, toward, weight, pdf):
    """Write a path that leaves a point.

    Parameters
    ----------
    onward : StreamAddresses
        Of `Paths`.
    row : uint64
    pixel : int64
    tables : SceneTables
    point : Point
    toward, weight : tuple of three float64
    pdf : float64
    """
    scatter(onward.pixels, row, pixel, True)
    scatter(onward.numbers, row, np.float32(pdf), True)
    put_vectors(onward.origins, as_int32(row), spawned(tables, point, toward), True)
    put_vectors(onward.directions, as_int32(row), _narrowed(toward), True)
    put_vectors(onward.colors, as_int32(row), _narrowed(weight), True)


@device
def aimed(tables, point, found):
    """The ray from a point to a light: its origin, direction and end.

    Parameters
    ----------
    tables : SceneTables
    point : Point
    found : LightSample

    Returns
    -------
    origin, toward : tuple of three float64
        World space.
    t_max : float32
    """
    x, y, z = spawned(tables, point, found.toward)
    if found.is_far:
        return (x, y, z), found.toward, _INF
    px, py, pz = world_place(tables, found.target[0], found.target[1], found.target[2])
    return (x, y, z), (px - x, py - y, pz - z), _ONE


@device
def put_ray(rays, row, pixel, origin, toward, t_max, light):
    """Write a ray to a light, and what it brings.

    Parameters
    ----------
    rays : StreamAddresses
        Of `ShadowRays`.
    row : uint64
    pixel : int64
    origin, toward, light : tuple of three float64 or float32
    t_max : float32
    """
    scatter(rays.pixels, row, pixel, True)
    scatter(rays.numbers, row, t_max, True)
    put_vectors(rays.origins, as_int32(row), origin, True)
    put_vectors(rays.directions, as_int32(row), _narrowed(toward), True)
    put_vectors(rays.colors, as_int32(row), _narrowed(light), True)


@device
def _narrowed(a):
    return np.float32(a[0]), np.float32(a[1]), np.float32(a[2])


@device
def add_light(radiance, pixel, weights, color, factor):
    """Add light that a path brings to its pixel.

    Parameters
    ----------
    radiance : uint64
        Address of shape (P, 3), float32.
    pixel : int
        Its row.
    weights : tuple of three float32
        The path's.
    color : tuple of three float64
    factor : float64
    """
    row = as_int32(pixel)
    red, green, blue = vector_at(radiance, row)
    more = (
        red + np.float32(weights[0] * color[0] * factor),
        green + np.float32(weights[1] * color[1] * factor),
        blue + np.float32(weights[2] * color[2] * factor),
    )
    put_vectors(radiance, row, more, True)


@device
def put_paths(onward, first, mask, pixels, tables, point, toward, weight, pdf):
    """Write those of 16 paths that leave their points, one after the other.

    Parameters
    ----------
    onward : StreamAddresses
        Of `Paths` with slack, see `SLACK`.
    first : uint64
        The row of the first.
    mask : mask16
        Which of them go on.
    pixels : i64x16
    tables : SceneTables
    point : Point
    toward, weight : tuple of three f32x16
    pdf : f32x16
    """
    append_pixels(onward.pixels, first, pixels, mask)
    append_numbers(onward.numbers, first, pdf, mask)
    append_places(onward.origins, first, spawned(tables, point, toward), mask)
    append_vectors(onward.directions, first, toward, mask)
    append_vectors(onward.colors, first, weight, mask)


@device
def put_light_rays(rays, first, mask, pixels, tables, point, found, light):
    """Write rays from points to lights, as `put_paths` does.

    Parameters
    ----------
    rays : StreamAddresses
        Of `ShadowRays` with slack.
    first, mask, pixels, tables, point
        See `put_paths`.
    found : LightSample
    light : tuple of three f32x16
        What they bring.
    """
    x, y, z = spawned(tables, point, found.toward)
    px, py, pz = world_place(tables, found.target[0], found.target[1], found.target[2])
    toward = (
        select(found.is_far, found.toward[0], narrow(px - x)),
        select(found.is_far, found.toward[1], narrow(py - y)),
        select(found.is_far, found.toward[2], narrow(pz - z)),
    )
    append_pixels(rays.pixels, first, pixels, mask)
    append_numbers(rays.numbers, first, select(found.is_far, _INF, f32x16(_ONE)), mask)
    append_places(rays.origins, first, (x, y, z), mask)
    append_vectors(rays.directions, first, toward, mask)
    append_vectors(rays.colors, first, light, mask)


@device
def add_lights(radiance, pixel, light, mask):
    """Add light to pixels of which no two are the same.

    Parameters
    ----------
    radiance : uint64
        Address of shape (P, 3), float32.
    pixel : i32x16
        Rows.
    light : tuple of three f32x16
    mask : mask16
        Which of them.
    """
    old = vector_at(radiance, pixel)
    put_vectors(radiance, pixel, (old[0] + light[0], old[1] + light[1], old[2] + light[2]), mask)


@device
def add_if_unblocked(i, rays, blocked, first_pixel, radiance):
    """Add what ray i to a light brings, unless something is in its way.

    Parameters
    ----------
    i : uint64
    rays : StreamAddresses
        Of `ShadowRays`.
    blocked : uint64
        Address of a byte for each ray, 0 where nothing is in its way.
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
    """Add what rays to lights bring where nothing is in their way.

    Parameters
    ----------
    rays : ShadowRays
    blocked : ndarray of shape (N,), bool
    first_pixel : int
        The pixel of row 0 of `radiance`.
    radiance : ndarray of shape (P, 3), float32
        Changed.
    """
    places, answers, base = addresses_of(rays), address(blocked), address(radiance)
    for i in range(np.uint64(len(rays.pixels))):
        add_if_unblocked(i, places, answers, first_pixel, base)
