"""Kernels of the à-trous wavelet filter: edge-avoiding weighted means of neighbours.

The spacing of the 5 x 5 kernel's taps doubles in each pass: five passes cover 125 pixels with 25
reads each (Dammertz et al. 2010). Weights are those of the spatial filter
of Schied et al. 2017, equations 2 to 5, and one on albedo in the form of Dammertz's.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    absolute,
    any_lane,
    exponential,
    f32x16,
    load,
    maximum,
    minimum,
    select,
    square_root,
    store,
)
from raystream.rendering.color import LUMINANCE

#: Pixels that are filtered at once.
LANES = 16

#: Columns of zeros at both sides of a plane: what the taps of the last pass reach.
MARGIN = 32

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

#: Added to the weights of pixels, which are 0 beside the image.
_LEAST = np.float32(1e-30)

_ZERO, _ONE, _INF = np.float32(0), np.float32(1), np.float32(np.inf)
_RED, _GREEN, _BLUE = map(np.float32, LUMINANCE)
_BYTES = 4


class Planes(NamedTuple):
    """Images as planes of float32 of the same size, see `as_planes`, by address.

    Attributes
    ----------
    guides : uint64
        Eleven planes that distinguish surfaces, the same in all passes: normals of length 1, and a
        fourth number that is 1 where there is no normal, for misses; depth, infinite for misses;
        change of depth per pixel to the right and down; albedo; and 1 in the image, beside which
        all planes are 0.
    light, filtered : uint64
        Four planes each: linear RGB, finite; and the variance of its luminance, finite.
    height, stride : int
        Rows, and floats from one to the next.
    """

    guides: np.uint64
    light: np.uint64
    filtered: np.uint64
    height: int
    stride: int


def stride_of(width: int) -> int:
    """Columns of the planes of an image: its own, up to the next `LANES`, and the margins."""
    return 2 * MARGIN + -(-width // LANES) * LANES


def as_planes(*images: NDArray[np.float32]) -> NDArray[np.float32]:
    """Images of shape (H, W) or (H, W, K) as planes of shape (P, H, stride), 0 beside them."""
    layers = [image[:, :, None] if image.ndim == 2 else image for image in images]
    height, width = layers[0].shape[:2]
    planes = np.zeros((sum(one.shape[2] for one in layers), height, stride_of(width)), np.float32)
    first = 0
    for layer in layers:
        end = first + layer.shape[2]
        planes[first:end, :, MARGIN : MARGIN + width] = layer.transpose(2, 0, 1)
        first = end
    return planes


@kernel
def filter_rows(begin, end, step, planes):
    """Filter some rows of an image in one pass, 16 pixels at once.

    One by one they took seven times as long.

    Parameters
    ----------
    begin, end : int
        Rows.
    step : int
        Spacing of the taps in pixels, at most half of `MARGIN`.
    planes : Planes
        `filtered` is written in these rows.
    """
    height, stride = planes.height, planes.stride
    pitch = np.uint64(height * stride * _BYTES)
    for y in range(begin, end):
        for x in range(MARGIN, stride - MARGIN, LANES):
            offset = np.uint64((y * stride + x) * _BYTES)
            surface = _surface(planes.guides + offset, pitch)
            at = planes.light + offset
            red, green, blue = _color(at, pitch)
            bright = _luminance(red, green, blue)
            spread = square_root(_blurred(planes, y, offset, pitch)) * STRENGTH + _LEAST_SPREAD
            # Sums of differences: among equal neighbours light keeps its bits.
            total, squares = f32x16(_ZERO), f32x16(_ZERO)
            reds, greens, blues = f32x16(_ZERO), f32x16(_ZERO), f32x16(_ZERO)
            for j in range(-2, 3):
                if y + j * step < 0 or y + j * step >= height:
                    continue
                for i in range(-2, 3):
                    shift = np.uint64((j * step * stride + i * step) * _BYTES)
                    other = _color(at + shift, pitch)
                    share = _SPLINE[abs(i)] * _SPLINE[abs(j)]
                    weight = f32x16(share)
                    if i != 0 or j != 0:
                        unlike = absolute(_luminance(other[0], other[1], other[2]) - bright)
                        away = np.float32(i * step), np.float32(j * step)
                        neighbour = planes.guides + offset + shift
                        weight *= _likeness(surface, neighbour, pitch, away, unlike / spread)
                    total += weight
                    reds += weight * (other[0] - red)
                    greens += weight * (other[1] - green)
                    blues += weight * (other[2] - blue)
                    squares += weight * weight * _plane(at + shift, pitch, 3)
            to = planes.filtered + offset
            store(to, red + reds / total)
            store(to + pitch, green + greens / total)
            store(to + pitch + pitch, blue + blues / total)
            store(to + pitch + pitch + pitch, squares / (total * total))


@kernel
def estimate_rows(begin, end, planes):
    """Estimate the variance of luminance from neighbours, where it is unknown.

    Parameters
    ----------
    begin, end : int
        Rows.
    planes : Planes
        The variance of `light` is written where it is infinite: the variance over those of 7 x 7
        pixels that show the same surface.
    """
    height, stride = planes.height, planes.stride
    pitch = np.uint64(height * stride * _BYTES)
    for y in range(begin, end):
        for x in range(MARGIN, stride - MARGIN, LANES):
            offset = np.uint64((y * stride + x) * _BYTES)
            at = planes.light + offset
            variance = _plane(at, pitch, 3)
            is_unknown = variance == _INF
            if not any_lane(is_unknown):
                continue
            surface = _surface(planes.guides + offset, pitch)
            red, green, blue = _color(at, pitch)
            bright = _luminance(red, green, blue)
            total, mean, square = f32x16(_ONE), f32x16(_ZERO), f32x16(_ZERO)
            for j in range(-_ESTIMATE_REACH, _ESTIMATE_REACH + 1):
                if y + j < 0 or y + j >= height:
                    continue
                for i in range(-_ESTIMATE_REACH, _ESTIMATE_REACH + 1):
                    if i == 0 and j == 0:
                        continue
                    shift = np.uint64((j * stride + i) * _BYTES)
                    away = np.float32(i), np.float32(j)
                    neighbour = planes.guides + offset + shift
                    weight = _likeness(surface, neighbour, pitch, away, f32x16(_ZERO))
                    # Relative to this pixel, which keeps small differences exact.
                    red, green, blue = _color(at + shift, pitch)
                    difference = _luminance(red, green, blue) - bright
                    total += weight
                    mean += weight * difference
                    square += weight * difference * difference
            mean /= total
            found = maximum(square / total - mean * mean, _ZERO)
            store(at + pitch + pitch + pitch, select(is_unknown, found, variance))


@device
def _plane(at, pitch, number):
    """Sixteen pixels of a plane, which is `number` planes behind the one of an address."""
    return load(f32x16, at + pitch * np.uint64(number))


@device
def _color(at, pitch):
    return _plane(at, pitch, 0), _plane(at, pitch, 1), _plane(at, pitch, 2)


@device
def _surface(at, pitch):
    """The normal, depth, slopes and albedo at pixels."""
    return (
        (_plane(at, pitch, 0), _plane(at, pitch, 1), _plane(at, pitch, 2), _plane(at, pitch, 3)),
        _plane(at, pitch, 4),
        (_plane(at, pitch, 5), _plane(at, pitch, 6)),
        (_plane(at, pitch, 7), _plane(at, pitch, 8), _plane(at, pitch, 9)),
    )


@device
def _likeness(surface, neighbour, pitch, away, unlike):
    """Similarity of pixels' surfaces to those of neighbours: 0 to 1; 0 outside the image.

    Parameters
    ----------
    surface : tuple
        Of the pixels, see `_surface`.
    neighbour : uint64
        Address of the first neighbour in the first of the guides.
    pitch : uint64
        Bytes of a plane.
    away : (float32, float32)
        Columns and rows from a pixel to its neighbour.
    unlike : f32x16
        Other dissimilarity, as an exponent.
    """
    normal, depth, slopes, albedo = surface
    toward, other, _, color = _surface(neighbour, pitch)
    slack = absolute(slopes[0] * away[0] + slopes[1] * away[1]) + _DEPTH_SLACK * absolute(depth)
    # Both may be 0, and so the slack; or both infinite, of misses. One alone is infinitely unlike.
    unlike += select(depth == other, f32x16(_ZERO), absolute(other - depth) / slack)
    red, green, blue = color[0] - albedo[0], color[1] - albedo[1], color[2] - albedo[2]
    unlike += (red * red + green * green + blue * blue) / (_ALBEDO_SPREAD * _ALBEDO_SPREAD)
    cosine = normal[0] * toward[0] + normal[1] * toward[1] + normal[2] * toward[2]
    cosine += normal[3] * toward[3]
    # False for NaN too, of infinite depth beside other depths.
    is_like = (cosine > _ZERO) & (unlike < _MOST_UNLIKE)
    cosine = minimum(cosine, _ONE)
    for _ in range(_NORMAL_SQUARINGS):
        cosine *= cosine
    return select(is_like, cosine * exponential(-unlike), f32x16(_ZERO))


@device
def _blurred(planes, y, offset, pitch):
    """Mean variance over 3 x 3 pixels of the image, since a single one is noisy."""
    total, found = f32x16(_LEAST), f32x16(_ZERO)
    for j in range(-1, 2):
        if y + j < 0 or y + j >= planes.height:
            continue
        for i in range(-1, 2):
            at = offset + np.uint64((j * planes.stride + i) * _BYTES)
            weight = _BLUR[abs(i)] * _BLUR[abs(j)] * _plane(planes.guides + at, pitch, 10)
            total += weight
            found += weight * _plane(planes.light + at, pitch, 3)
    return found / total


@device
def _luminance(red, green, blue):
    return _RED * red + _GREEN * green + _BLUE * blue
