"""Kernels of the à-trous wavelet filter: edge-avoiding weighted means of neighbours.

The spacing of the 5 x 5 kernel's taps doubles in each pass: five passes cover 125 pixels with 25
reads each (Dammertz et al. 2010). Weights are those of the spatial filter
of Schied et al. 2017, equations 2 to 5, and one on albedo in the form of Dammertz's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.rendering.color import LUMINANCE

__all__ = ["STRENGTH", "Guides", "estimate_rows", "filter_rows"]

#: Weights of the B3 spline at 0, 1 and 2 steps.
_SPLINE = (np.float32(3 / 8), np.float32(1 / 4), np.float32(1 / 16))

#: Weights of the 3 x 3 Gaussian of variances at 0 and 1 pixels.
_BLUR = (np.float32(1 / 2), np.float32(1 / 4))

#: Tolerance of depth differences beyond the slope, relative to depth: for curved surfaces, and
#: because depths are means over a pixel.
_DEPTH_SLACK = np.float32(5e-3)

#: Difference of albedo that divides the weight by e. It is large, so that texels of different
#: colours are averaged: light is filtered without its albedo.
_ALBEDO_SPREAD = np.float32(0.5)

#: Standard deviations of luminance that count as noise (Schied et al. 2017).
STRENGTH = np.float32(4)

#: Least standard deviation of luminance: rounding errors.
_LEAST_SPREAD = np.float32(1e-6)

#: Beyond this exponent, weights underflow in float32.
_MOST_UNLIKE = np.float32(87)

#: Number of squarings for Schied's exponent of normals, 128.
_NORMAL_SQUARINGS = 7

#: Radius of `estimate_rows`: 7 x 7 pixels, as Schied.
_ESTIMATE_REACH = 3

_ZERO, _ONE = np.float32(0), np.float32(1)
_RED, _GREEN, _BLUE = map(np.float32, LUMINANCE)


class Guides(NamedTuple):
    """Guide images that distinguish surfaces; the same in all passes.

    Attributes
    ----------
    normals : ndarray of shape (H, W, 3), float32
        Of length 1, or 0 for misses.
    depth : ndarray of shape (H, W), float32
        Infinite for misses.
    slopes : ndarray of shape (H, W, 2), float32
        Change of depth per pixel to the right and down.
    albedo : ndarray of shape (H, W, 3), float32
    """

    normals: NDArray[np.float32]
    depth: NDArray[np.float32]
    slopes: NDArray[np.float32]
    albedo: NDArray[np.float32]


@kernel
def filter_rows(begin, end, step, guides, light, variance, out_light, out_variance):
    """Filter some rows of an image in one pass.

    Parameters
    ----------
    begin, end : int
        Rows.
    step : int
        Spacing of the taps in pixels.
    guides : Guides
    light : ndarray of shape (H, W, 3), float32
        Finite.
    variance : ndarray of shape (H, W), float32
        Of the luminance of `light`; finite.
    out_light, out_variance : ndarray
        As `light` and `variance`; written in these rows.
    """
    height, width = variance.shape
    for y in range(begin, end):
        for x in range(width):
            spread = math.sqrt(_blurred(variance, y, x)) * STRENGTH + _LEAST_SPREAD
            bright = _luminance(light, y, x)
            # Sums of differences: among equal neighbours light keeps its bits.
            total = _ZERO
            red, green, blue, squares = _ZERO, _ZERO, _ZERO, _ZERO
            for j in range(-2, 3):
                v = y + j * step
                if v < 0 or v >= height:
                    continue
                for i in range(-2, 3):
                    u = x + i * step
                    if u < 0 or u >= width:
                        continue
                    weight = _SPLINE[abs(i)] * _SPLINE[abs(j)]
                    if i != 0 or j != 0:
                        unlike = abs(_luminance(light, v, u) - bright) / spread
                        weight *= _likeness(guides, y, x, v, u, unlike)
                    total += weight
                    red += weight * (light[v, u, 0] - light[y, x, 0])
                    green += weight * (light[v, u, 1] - light[y, x, 1])
                    blue += weight * (light[v, u, 2] - light[y, x, 2])
                    squares += weight * weight * variance[v, u]
            out_light[y, x, 0] = light[y, x, 0] + red / total
            out_light[y, x, 1] = light[y, x, 1] + green / total
            out_light[y, x, 2] = light[y, x, 2] + blue / total
            out_variance[y, x] = squares / (total * total)


@kernel
def estimate_rows(begin, end, guides, light, variance):
    """Estimate the variance of luminance from neighbours, where it is unknown.

    Parameters
    ----------
    begin, end : int
        Rows.
    guides : Guides
    light : ndarray of shape (H, W, 3), float32
    variance : ndarray of shape (H, W), float32
        Written where it is infinite: the variance over those of 7 x 7 pixels that show the same
        surface.
    """
    height, width = variance.shape
    for y in range(begin, end):
        for x in range(width):
            if variance[y, x] < np.inf:
                continue
            bright = _luminance(light, y, x)
            total, mean, square = _ONE, _ZERO, _ZERO
            for v in range(max(y - _ESTIMATE_REACH, 0), min(y + _ESTIMATE_REACH + 1, height)):
                for u in range(max(x - _ESTIMATE_REACH, 0), min(x + _ESTIMATE_REACH + 1, width)):
                    if v != y or u != x:
                        weight = _likeness(guides, y, x, v, u, _ZERO)
                        # Relative to this pixel, which keeps small differences exact.
                        difference = _luminance(light, v, u) - bright
                        total += weight
                        mean += weight * difference
                        square += weight * difference * difference
            mean /= total
            variance[y, x] = max(square / total - mean * mean, _ZERO)


@device
def _likeness(guides, y, x, v, u, unlike):
    """Similarity of two pixels' surfaces: 0 to 1.

    Parameters
    ----------
    guides : Guides
    y, x, v, u : int
        Row and column of the pixels.
    unlike : float32
        Other dissimilarity, as an exponent.
    """
    depth, other = guides.depth[y, x], guides.depth[v, u]
    if math.isinf(depth) or math.isinf(other):
        if depth != other:
            return _ZERO
    else:
        across = guides.slopes[y, x, 0] * np.float32(u - x)
        down = guides.slopes[y, x, 1] * np.float32(v - y)
        slack = abs(across + down) + _DEPTH_SLACK * abs(depth)
        if depth != other:  # both may be 0, and so the slack
            unlike += abs(other - depth) / slack
    cosine, length, other_length = _ZERO, _ZERO, _ZERO
    for k in range(3):
        cosine += guides.normals[y, x, k] * guides.normals[v, u, k]
        length += guides.normals[y, x, k] * guides.normals[y, x, k]
        other_length += guides.normals[v, u, k] * guides.normals[v, u, k]
        change = (guides.albedo[v, u, k] - guides.albedo[y, x, k]) / _ALBEDO_SPREAD
        unlike += change * change
    if length == _ZERO and other_length == _ZERO:
        cosine = _ONE
    if not (cosine > _ZERO and unlike < _MOST_UNLIKE):  # NaN too, of infinite slopes
        return _ZERO
    cosine = min(cosine, _ONE)
    for _ in range(_NORMAL_SQUARINGS):
        cosine *= cosine
    return cosine * math.exp(-unlike)


@device
def _blurred(variance, y, x):
    """Mean variance over 3 x 3 pixels, since a single one is noisy."""
    height, width = variance.shape
    total, found = _ZERO, _ZERO
    for j in range(max(y - 1, 0), min(y + 2, height)):
        for i in range(max(x - 1, 0), min(x + 2, width)):
            weight = _BLUR[abs(i - x)] * _BLUR[abs(j - y)]
            total += weight
            found += weight * variance[j, i]
    return found / total


@device
def _luminance(light, y, x):
    return _RED * light[y, x, 0] + _GREEN * light[y, x, 1] + _BLUE * light[y, x, 2]
