"""Camera rays of perspective cameras, with a pinhole or a thin lens."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    as_int32,
    as_uint32,
    f32x16,
    f64x16,
    i32x16,
    i64x16,
    lane_numbers,
    narrow,
    scatter,
    square_root,
    u32x16,
    widen,
)
from raystream.rendering.sampling.sampler import draw_pair_lanes
from raystream.rendering.sampling.warp import disk
from raystream.rendering.shading.rows import put_vectors
from raystream.rendering.shading.streams import addresses_of
from raystream.scene.camera import Camera

_HALF, _WHOLE, _INF = np.float32(0.5), np.float32(1.0), np.float32(np.inf)

#: Of vectors.
_LANES = 16

Vector = tuple[float, float, float]


class View(NamedTuple):
    """A perspective camera and the size of its image.

    Attributes
    ----------
    eye : tuple of three float
        World space.
    right, up, forward : tuple of three float
        Unit vectors.
    scale : float
        Height of a pixel at distance 1.
    radius, focus : float
        Radius of the lens, world units, 0 for a pinhole; distance of the plane in focus.
    width, height : int
        Pixels.
    """

    eye: Vector
    right: Vector
    up: Vector
    forward: Vector
    scale: float
    radius: float
    focus: float
    width: int
    height: int


def view_of(camera: Camera, width: int, height: int) -> View:
    """The `View` of a perspective camera."""
    right, up, forward = camera.basis()
    return View(
        _vector(camera.eye),
        _vector(right),
        _vector(up),
        _vector(forward),
        2.0 * math.tan(math.radians(camera.fov) / 2.0) / height,
        0.5 * camera.aperture,
        camera.focus_distance,
        width,
        height,
    )


def _vector(values: object) -> Vector:
    x, y, z = (float(value) for value in np.asarray(values))
    return x, y, z


@device
def _combined(a, x, b, y):
    """A linear combination of two vectors."""
    return a[0] * x + b[0] * y, a[1] * x + b[1] * y, a[2] * x + b[2] * y


@device
def camera_ray_block(view, first_row, row, first, sampler, sample, paths):
    """Generate the camera rays of 16 pixels of a row.

    Parameters
    ----------
    view : View
    first_row, row, first : int
        First row of the band, row within the band, and first of 16 columns.
    sampler : Sampler
    sample : int
    paths : StreamAddresses
        Of the band's paths: pixels, origins and directions are written.
    """
    samples = u32x16(as_uint32(sample))
    column = lane_numbers(i32x16) + as_int32(first)
    mask = column < as_int32(view.width)
    place = column + as_int32(row * view.width)
    pixel = place + as_int32(first_row * view.width)
    u, v = f32x16(_HALF), f32x16(_HALF)
    if sampler.sample_count > 1:
        u, v = draw_pair_lanes(sampler, as_uint32(pixel), samples, 0)
    across = (f64x16(column) + widen(u) - 0.5 * view.width) * view.scale
    down = (widen(v) + (first_row + row - 0.5 * view.height)) * view.scale
    x, y, z = _combined(view.right, across, view.up, -down)
    toward = x + view.forward[0], y + view.forward[1], z + view.forward[2]
    origin = f64x16(view.eye[0]), f64x16(view.eye[1]), f64x16(view.eye[2])
    if view.radius > 0.0 and sampler.sample_count > 1:
        u, v = draw_pair_lanes(sampler, as_uint32(pixel), samples, 2)
        a, b = disk(u, v)
        x, y, z = _combined(view.right, widen(a) * view.radius, view.up, widen(b) * view.radius)
        origin = origin[0] + x, origin[1] + y, origin[2] + z
        toward = (
            toward[0] * view.focus - x,
            toward[1] * view.focus - y,
            toward[2] * view.focus - z,
        )
    x, y, z = toward
    length = square_root(x * x + y * y + z * z)
    scatter(paths.pixels, place, i64x16(pixel), mask)
    put_vectors(paths.origins, place, origin, mask)
    x, y, z = narrow(x / length), narrow(y / length), narrow(z / length)
    put_vectors(paths.directions, place, (x, y, z), mask)


@kernel
def generate_camera_rays(view, first_row, row_count, sampler, sample, paths):
    """Generate a camera ray for each pixel of some rows: through its centre if there is one sample.

    Parameters
    ----------
    view : View
    first_row, row_count : int
    sampler : Sampler
    sample : int
    paths : Paths
        `row_count` times the image's width; written.
    """
    for i in range(row_count * view.width):
        paths.weights[i, 0] = paths.weights[i, 1] = paths.weights[i, 2] = _WHOLE
        paths.pdfs[i] = _INF
    for row in range(row_count):
        for first in range(0, view.width, _LANES):
            camera_ray_block(view, first_row, row, first, sampler, sample, addresses_of(paths))
