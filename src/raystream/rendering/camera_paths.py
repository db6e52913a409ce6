"""Camera paths: the first rays of an image's pixels, from any camera."""

from __future__ import annotations

import numpy as np

from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.camera_rays import generate_camera_rays, view_of
from raystream.rendering.shading.streams import Paths
from raystream.scene.camera import Camera


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
