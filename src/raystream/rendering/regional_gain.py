"""regional_gain: returns to a filtered image the light that the filter took from it.

A filter that rejects outliers darkens an image: the few bright samples among many dark ones carry
light that belongs to their surroundings. A gain that varies slowly over the image restores the
mean of each region, and keeps edges and textures.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Standard deviation of a region, relative to the larger side of the image: wide enough that
#: a single pixel's light is not seen as a spot.
_REGION = 1.0 / 16.0

#: Largest gain of a region, and the inverse of the smallest, relative to the whole image.
_MOST_GAIN = 2.0

#: Largest gain of the whole image: a filter that loses more has found no light at all.
_MOST_IN_ALL = 100.0

#: Brightness of a region, relative to the brightest, below which rounding errors decide.
_LEAST_AROUND = 1e-9


def regional_gain(smooth: NDArray[np.float64], lost: NDArray[np.float64]) -> NDArray[np.float64]:
    """The gain that restores the mean of regions, and of the image.

    Parameters
    ----------
    smooth : ndarray of shape (H, W), float64
        Luminance of the filtered image.
    lost : ndarray of shape (H, W), float64
        Luminance that the filter took from each pixel, or gave it (negative).

    Returns
    -------
    ndarray of shape (H, W), float64
        At least 0; exactly 1 if nothing was lost.

    Notes
    -----
    What a pixel loses is spread over its region in proportion to the brightness there, with
    weights that add up to 1 for each pixel: the sum of the image is preserved. Gains outside 1/2
    to 2 are clamped, and the rest is spread over the whole image.
    """
    smooth = np.maximum(smooth, 0.0)
    radius = max(1, round(max(smooth.shape) * _REGION))
    around = _blur(smooth, radius)
    is_lit = around > _LEAST_AROUND * around.max()
    share = np.divide(lost, around, out=np.zeros_like(lost), where=is_lit)
    gain = np.clip(1.0 + _blur(share, radius), 1.0 / _MOST_GAIN, _MOST_GAIN)
    found = float(np.sum(smooth * gain))
    if found > 0.0:
        gain *= min(max(float(np.sum(smooth + lost)) / found, 0.0), _MOST_IN_ALL)
    return gain


def _blur(values: NDArray[np.float64], radius: int) -> NDArray[np.float64]:
    """Weighted sums over each pixel's region: three box filters, nearly a Gaussian.

    The weight of a pixel for another equals that of the other for it.
    """
    for axis in (0, 1):
        count = values.shape[axis]
        places = np.arange(count)
        first = np.maximum(places - radius, 0)
        last = np.minimum(places + radius, count - 1) + 1
        for _ in range(3):
            sums = np.insert(np.cumsum(values, axis=axis), 0, 0.0, axis=axis)
            values = sums.take(last, axis) - sums.take(first, axis)
    return values
