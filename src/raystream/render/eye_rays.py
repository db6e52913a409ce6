"""Eye rays: the source of every renderer's stream (Purcell 2002, 3.1.1)."""

from __future__ import annotations

import numpy as np

from raystream.render.stages import RayStream
from raystream.scene.camera import Camera

__all__ = ["eye_rays"]

# The R2 sequence, a generalised golden ratio, spreads the samples of a pixel evenly
# (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
_PLASTIC = 1.32471795724474602596
_STEP = np.array([1.0 / _PLASTIC, 1.0 / _PLASTIC**2])


def eye_rays(
    camera: Camera,
    width: int,
    height: int,
    rows: range,
    sample: int,
    samples: int,
    seed: int,
) -> RayStream:
    """Make one ray for each pixel of some rows.

    Parameters
    ----------
    camera : Camera
    width, height : int
        Size of the whole picture.
    rows : range
        Rows of the picture.
    sample, samples : int
        Which of how many samples. A single one goes through the pixels' centres; many are
        spread over each pixel, shifted at random from pixel to pixel.
    seed : int
        The same seed gives the same rays.

    Returns
    -------
    RayStream
        Weights are 1.
    """
    x = np.arange(width, dtype=np.float64)[None, :]
    y = np.array(rows, np.float64)[:, None]
    count = x.size * y.size
    if samples == 1:
        x, y = x + 0.5, y + 0.5
    else:
        # Each row has its own generator: a picture does not depend on how it is cut up.
        shift = np.stack([np.random.default_rng([seed, row]).random((2, width)) for row in rows], 1)
        x = x + (shift[0] + sample * _STEP[0]) % 1.0
        y = y + (shift[1] + sample * _STEP[1]) % 1.0
    origins, directions = camera.rays(width, height, x, y)
    return RayStream(
        rows.start * width + np.arange(count),
        origins.reshape(-1, 3),
        directions.reshape(-1, 3),
        np.ones((count, 3), np.float32),
    )
