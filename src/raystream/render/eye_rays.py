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

# The same in four dimensions, for a place in the pixel and a place in the lens together: two
# sequences of their own would tie one to the other.
_GOLDEN_4 = 1.16730397826141868426
_LENS_STEP = np.array([_GOLDEN_4**-k for k in (1, 2, 3, 4)])


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
        Which of how many samples. A single one goes through the pixels' centres, and through
        the middle of a lens; many are spread over each pixel and over the lens, shifted at
        random from pixel to pixel.
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
    lens = None
    if samples == 1:
        x, y = x + 0.5, y + 0.5
    else:
        step = _STEP if camera.aperture == 0.0 else _LENS_STEP
        # Each row has its own generator: a picture does not depend on how it is cut up.
        size = len(step), width
        shift = np.stack([np.random.default_rng([seed, row]).random(size) for row in rows], 1)
        places = [(shift[k] + sample * step[k]) % 1.0 for k in range(len(step))]
        x, y = x + places[0], y + places[1]
        lens = np.stack(places[2:], axis=-1) if camera.aperture > 0.0 else None
    origins, directions = camera.rays(width, height, x, y, lens)
    return RayStream(
        rows.start * width + np.arange(count),
        origins.reshape(-1, 3),
        directions.reshape(-1, 3),
        np.ones((count, 3), np.float32),
    )
