"""Camera paths: the first rays of an image's pixels, from any camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.camera_rays import (
    generate_camera_rays,
    generate_tile_rays,
    view_of,
)
from raystream.rendering.shading.streams import PIXEL_BITS, Paths
from raystream.scene.camera import Camera

__all__ = ["camera_paths", "tile_camera_paths"]


def camera_paths(
    camera: Camera, size: tuple[int, int], sampler: Sampler, rows: range, sample: int
) -> Paths:
    """Generate camera rays for some rows of an image (Purcell 2002, 3.1.1).

    Parameters
    ----------
    camera : Camera
    size : (int, int)
        Width and height of the whole image.
    sampler : Sampler
        A single sample goes through the pixels' centres and the centre of the lens; several
        are distributed over pixel and lens, by dimensions 0 to 3.
    rows : range
    sample : int
    """
    width, _ = size
    count = len(rows) * width
    if camera.projection == "perspective":
        paths = Paths.empty(count)
        generate_camera_rays(view_of(camera, *size), rows.start, len(rows), sampler, sample, paths)
        return paths
    pixels = np.arange(rows.start * width, rows.start * width + count)
    return _projected(camera, size, sampler, pixels, sample)


def tile_camera_paths(
    camera: Camera,
    size: tuple[int, int],
    sampler: Sampler,
    corners: NDArray[np.int64],
    pixels: NDArray[np.int64],
    samples: NDArray[np.int64],
) -> Paths:
    """Generate camera rays for the pixels of some tiles, with the bits of `camera_paths`.

    Parameters
    ----------
    camera, size, sampler
        See `camera_paths`.
    corners : ndarray of shape (T, 4), int64
        First column and row of each tile, its width and height.
    pixels : ndarray of shape (N,), int64
        Of the tiles, one after another, each row by row.
    samples : ndarray of shape (T,), int64
        Number of the sample of each tile.
    """
    if camera.projection == "perspective":
        paths = Paths.empty(len(pixels))
        generate_tile_rays(view_of(camera, *size), corners, samples, sampler, paths)
        return paths
    each = samples.repeat(corners[:, 2] * corners[:, 3])
    paths = _projected(camera, size, sampler, pixels, each)
    paths.pixels[:] |= each << PIXEL_BITS
    return paths


def _projected(
    camera: Camera,
    size: tuple[int, int],
    sampler: Sampler,
    pixels: NDArray[np.int64],
    sample: int | NDArray[np.int64],
) -> Paths:
    """Generate camera rays of any camera through pixels."""
    width, _ = size
    x, y = (pixels % width).astype(np.float64), (pixels // width).astype(np.float64)
    if sampler.sample_count == 1:
        x, y = x + 0.5, y + 0.5
    else:
        numbers = sampler.numbers(pixels, sample, 0, 2)
        x, y = x + numbers[:, 0], y + numbers[:, 1]
    origins, directions = camera.rays(*size, x, y)
    paths = Paths.empty(len(pixels))
    paths.pixels[:], paths.weights[:], paths.pdfs[:] = pixels, 1.0, np.inf
    paths.origins[:], paths.directions[:] = origins, directions
    return paths
