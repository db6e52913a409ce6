"""The sky in 16 directions: radiance, density and samples.

Lanes are computed one by one: fetching scattered texels takes as long as the arithmetic between
them.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x16,
    lane,
    load,
    mask_bits,
    scratch,
    store,
    widen,
)
from raystream.rendering.shading.sky import image_radiance, relative_pdf, sample_image

# Bytes of a float32, of 16 of them, and of three rows of 16.
_WORD, _ROW, _ROWS = np.uint64(4), np.uint64(64), 192


@device
def _colors(color):
    """The same colour in all lanes."""
    red, green, blue = color
    return f32x16(np.float32(red)), f32x16(np.float32(green)), f32x16(np.float32(blue))


@device
def _wide(toward, i):
    return widen(lane(toward[0], i)), widen(lane(toward[1], i)), widen(lane(toward[2], i))


@device
def _put(rows, i, vector):
    """Write a vector's numbers to lane i of three rows in memory."""
    at = rows + i * _WORD
    store(at, np.float32(vector[0]))
    store(at + _ROW, np.float32(vector[1]))
    store(at + _ROW + _ROW, np.float32(vector[2]))


@device
def _rows(rows):
    return load(f32x16, rows), load(f32x16, rows + _ROW), load(f32x16, rows + _ROW + _ROW)


@device
def sky_radiance_lanes(lights, toward, mask):
    """`sky_radiance` for 16 directions, of `f32x16`; undefined where the mask is not set."""
    if lights.sky.image == NULL:
        return _colors(lights.sky.color)
    return image_radiance_lanes(lights.sky, toward, mask)


@device_call
def image_radiance_lanes(sky, toward, mask):
    """`image_radiance` for 16 directions; see `sky_radiance_lanes`."""
    rows, bits = scratch(_ROWS), mask_bits(mask)
    while bits != ZERO_U64:
        i = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        x, y, z = _wide(toward, i)
        _put(rows, i, image_radiance(sky, x, y, z))
    return _rows(rows)


@device
def sky_pdf_lanes(lights, toward, mask):
    """`sky_pdf` for 16 directions, of `f32x16`; undefined where the mask is not set."""
    density = f32x16(np.float32(lights.sky_density))
    if lights.sky.image == NULL:
        return density
    return density * relative_pdf_lanes(lights.sky, toward, mask)


@device_call
def relative_pdf_lanes(sky, toward, mask):
    """`relative_pdf` for 16 directions; see `sky_pdf_lanes`."""
    row, bits = scratch(_ROWS), mask_bits(mask)
    while bits != ZERO_U64:
        i = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        x, y, z = _wide(toward, i)
        store(row + i * _WORD, np.float32(relative_pdf(sky, x, y, z)))
    return load(f32x16, row)


@device_call
def sample_image_lanes(sky, u, v, mask):
    """`sample_image` for 16 pairs of numbers, `f32x16`; undefined where the mask is not set."""
    rows, densities, bits = scratch(_ROWS), scratch(_ROWS), mask_bits(mask)
    while bits != ZERO_U64:
        i = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        toward, density = sample_image(sky, widen(lane(u, i)), widen(lane(v, i)))
        _put(rows, i, toward)
        store(densities + i * _WORD, np.float32(density))
    return _rows(rows), load(f32x16, densities)
