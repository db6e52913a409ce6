"""Streams of paths, batches of them at surfaces, and the light that they add to pixels."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    address,
    as_int32,
    i32x16,
    lane_numbers,
    mask_bits,
    minimum,
    popcount,
    scatter,
)
from raystream.kernels.hits import HitAddresses
from raystream.rendering.shading.rows import (
    append_numbers,
    append_pixels,
    append_positions,
    append_vectors,
    put_vectors,
    vector_at,
)

_1 = np.int32(1)

#: Rows behind the last one of arrays that kernels write to, since they write whole vectors.
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
        Throughput: the share of the light that a ray finds which reaches its pixel.
    pdfs : ndarray of shape (N,), float32
        Density over solid angle with which the direction was chosen; inf for rays from the
        camera, from mirrors and through glass, whose light is not sampled in any other way.
    """

    pixels: NDArray[np.int64]
    origins: NDArray[np.float64]
    directions: NDArray[np.float32]
    weights: NDArray[np.float32]
    pdfs: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> Paths:
        """Allocate `count` rows, with slack."""
        return cls._make(empty_columns(count))

    def first(self, count: int) -> Paths:
        """The first `count` rows, shared."""
        return Paths._make(array[:count] for array in self)


class StreamAddresses(NamedTuple):
    """Addresses of the columns of `Paths` or `ShadowRays`.

    Attributes
    ----------
    pixels, origins, directions, colors, numbers : uint64
        In the order of `Paths` and `ShadowRays`; colors are weights or light, numbers are
        densities or ``t_max``.
    """

    pixels: np.uint64
    origins: np.uint64
    directions: np.uint64
    colors: np.uint64
    numbers: np.uint64


class StreamCursor(NamedTuple):
    """A stream that is being written.

    Attributes
    ----------
    columns : StreamAddresses
    row : uint64
        The next row to write.
    """

    columns: StreamAddresses
    row: np.uint64


class ShadingBatch(NamedTuple):
    """Paths with the hits of their rays, and the pixels to which they add light.

    Stages pass arrays to kernels; device functions take their addresses, see `batch_addresses`.

    Attributes
    ----------
    path_count : int
    paths : Paths or StreamAddresses
    hits : tuple of t, u, v, prim_id, or HitAddresses
        The nearest hit of each ray, as in `Hits`: contiguous arrays.
    first_pixel : int
        The pixel of row 0 of `radiance`.
    radiance : ndarray of shape (P, 3), float32, or uint64
        Linear RGB; light is added.
    """

    path_count: int
    paths: Any
    hits: Any
    first_pixel: int
    radiance: Any


def empty_columns(count: int) -> list[NDArray[Any]]:
    """Allocate the columns of `Paths` or `ShadowRays`, of `count` rows and slack behind them."""
    rows = count + SLACK
    pixels, origins = np.empty(rows, np.int64), np.empty((rows, 3))
    directions, colors = (np.empty((rows, 3), np.float32) for _ in range(2))
    numbers = np.empty(rows, np.float32)
    return [array[:count] for array in (pixels, origins, directions, colors, numbers)]


@device
def addresses_of(stream):
    """The addresses of a stream's columns: `Paths` or `ShadowRays`."""
    pixels, origins, directions, colors, numbers = stream
    return StreamAddresses(
        address(pixels), address(origins), address(directions), address(colors), address(numbers)
    )


@device
def batch_addresses(batch):
    """A `ShadingBatch` of arrays with their addresses instead."""
    ts, us, vs, prim_ids = batch.hits
    return ShadingBatch(
        batch.path_count,
        addresses_of(batch.paths),
        HitAddresses(address(ts), address(us), address(vs), address(prim_ids)),
        batch.first_pixel,
        address(batch.radiance),
    )


@device
def weights_of(paths, i):
    """Weights of path i of a stream, by its addresses: three float32."""
    return vector_at(paths.colors, as_int32(i))


@device
def direction_of(paths, i):
    """Direction of path i of a stream, by its addresses, and its length: float64."""
    x, y, z = vector_at(paths.directions, as_int32(i))
    x, y, z = np.float64(x), np.float64(y), np.float64(z)
    return x, y, z, math.sqrt(x * x + y * y + z * z)


@device
def _narrowed(a):
    return np.float32(a[0]), np.float32(a[1]), np.float32(a[2])


@device
def put_row(to, pixel, origin, direction, color, number):
    """Write a row of `Paths` or `ShadowRays`; returns the cursor behind it.

    Parameters
    ----------
    to : StreamCursor
    pixel : int64
    origin, direction, color : tuple of three float64
    number : float64
    """
    row = as_int32(to.row)
    scatter(to.columns.pixels, to.row, pixel, True)
    scatter(to.columns.numbers, to.row, np.float32(number), True)
    put_vectors(to.columns.origins, row, origin, True)
    put_vectors(to.columns.directions, row, _narrowed(direction), True)
    put_vectors(to.columns.colors, row, _narrowed(color), True)
    return StreamCursor(to.columns, to.row + ONE_U64)


@device
def append_rows(to, mask, pixels, origins, directions, colors, numbers):
    """Write the rows of masked lanes, without gaps; returns the cursor behind them.

    Parameters
    ----------
    to : StreamCursor
        Of a stream with slack, see `SLACK`.
    mask : mask16
    pixels : i64x16
    origins : tuple of three f64x16
    directions, colors : tuple of three f32x16
    numbers : f32x16
    """
    columns, first = to.columns, to.row
    append_pixels(columns.pixels, first, pixels, mask)
    append_numbers(columns.numbers, first, numbers, mask)
    append_positions(columns.origins, first, origins, mask)
    append_vectors(columns.directions, first, directions, mask)
    append_vectors(columns.colors, first, colors, mask)
    return StreamCursor(columns, first + popcount(mask_bits(mask)))


@device
def block_rows(first, batch):
    """Rows of 16 paths of a batch, i32x16, and a mask of those that exist; see `Paths`."""
    count = as_int32(batch.path_count)
    row = lane_numbers(i32x16) + as_int32(first)
    return minimum(row, as_int32(count - _1)), row < count


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
def add_lights(radiance, pixel, light, mask):
    """Add light to 16 pixels, all different.

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
