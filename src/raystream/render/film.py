"""Film: sums of the light that rays bring to pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.render.image import Image

__all__ = ["Film"]


class Film:
    """Collects light by pixel, for samples that are averaged in the end.

    Parameters
    ----------
    width, height : int
        In pixels.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self._sum = np.zeros((height * width, 3), np.float32)

    def add(self, pixels: NDArray[np.int64], radiance: NDArray[Any]) -> None:
        """Add light.

        Parameters
        ----------
        pixels : ndarray of shape (N,), int64
            Row times width plus column; one pixel may occur many times.
        radiance : ndarray of shape (N, 3), float
            Linear RGB.
        """
        if len(pixels) and np.all(pixels[1:] > pixels[:-1]):  # the usual case, much faster
            self._sum[pixels] += radiance
        else:
            np.add.at(self._sum, pixels, radiance)

    def image(self, samples: int) -> Image:
        """The picture, when each pixel had this many samples."""
        pixels = self._sum.reshape(self.height, self.width, 3) / np.float32(samples)
        return Image(pixels)
