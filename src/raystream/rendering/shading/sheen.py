"""Sheen: the light that fibres of cloth, mostly upright, reflect at grazing angles.

References
----------
Estevez and Kulla, "Production Friendly Microfacet Sheen BRDF", 2017. Khronos,
``KHR_materials_sheen``.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import (
    as_float32,
    as_int32,
    exponential,
    floor,
    gather,
    maximum,
    minimum,
    power,
    select,
    square_root,
    widen_number,
)
from raystream.rendering.shading.vectors import dot

#: Least roughness of sheen: with less, fibres are too nearly upright to be seen.
LEAST_SHEEN = 0.07

#: Rows, by roughness from `LEAST_SHEEN` to 1, and columns, by square roots of cosines from 0 to
#: 1, of the table of albedos; samples of its integrals, by height and by azimuth.
_ROWS, _COLUMNS = 32, 32
_HEIGHTS, _AZIMUTHS = 48, 32

_NULL, _HALF, _WHOLE, _TWO, _FOUR = map(np.float32, (0.0, 0.5, 1.0, 2.0, 4.0))
_INV_TWO_PI = np.float32(0.5 / math.pi)
_LEAST_COSINE = np.float32(1e-4)
_1 = np.int32(1)
_LAST_COLUMN, _WIDTH = np.float32(_COLUMNS - 1), np.int32(_COLUMNS)
_LEAST = np.float32(LEAST_SHEEN)
_ROWS_PER_ROUGHNESS = np.float32((_ROWS - 1) / (1.0 - LEAST_SHEEN))

#: Of the masking function, for alpha 0 and for 1, by the square of 1 - alpha.
_SOFT = tuple(map(np.float32, (21.5473, 3.82987, 0.19823, -1.97760, -4.32054)))
_SHARP = tuple(map(np.float32, (25.3245, 3.32435, 0.16801, -1.27393, -4.85967)))


@device
def _mixed(k, share):
    return _SOFT[k] + (_SHARP[k] - _SOFT[k]) * share


@device
def _fitted(cosine, share):
    """L(x) of Estevez and Kulla, a fit."""
    a, b, c = _mixed(0, share), _mixed(1, share), _mixed(2, share)
    return a / (_WHOLE + b * power(cosine, c)) + _mixed(3, share) * cosine + _mixed(4, share)


@device
def _masking(cosine, alpha):
    """Their Lambda, without the softened terminator."""
    share = (_WHOLE - alpha) * (_WHOLE - alpha)
    is_steep = cosine >= _HALF
    value = _fitted(select(is_steep, _WHOLE - cosine, cosine), share)
    twice = _TWO * _fitted(cosine * _NULL + _HALF, share)
    return exponential(select(is_steep, twice - value, value))


@device_call
def eval_sheen(alpha, normal, back, toward):
    """The BRDF of fibres that reflect all light, times the cosine.

    Parameters
    ----------
    alpha : float64
        Squared roughness.
    normal, back, toward : tuple of three float64
        Unit vectors; the others are on the normal's side.
    """
    x, y, z = back[0] + toward[0], back[1] + toward[1], back[2] + toward[2]
    square = x * x + y * y + z * z
    height = dot(normal, (x, y, z))
    sine = maximum(_WHOLE - height * height / select(square > _NULL, square, _WHOLE), _NULL)
    sharpness = _WHOLE / alpha
    density = (_TWO + sharpness) * power(sine, _HALF * sharpness) * _INV_TWO_PI
    view = minimum(maximum(dot(normal, back), _LEAST_COSINE), _WHOLE)
    light = minimum(maximum(dot(normal, toward), _LEAST_COSINE), _WHOLE)
    hidden = _WHOLE + _masking(view, alpha) + _masking(light, alpha)
    return density / (_FOUR * view * hidden)


@kernel
def integrate_sheen(least, albedos):
    """Integrate `eval_sheen` over all directions of light.

    Parameters
    ----------
    least : float
        Roughness of the first row; that of the last one is 1.
    albedos : ndarray of shape (R, C), float32
        Written: by roughness, and by square roots of the view's cosines from 0 to 1.
    """
    rows, columns = albedos.shape
    upward = (0.0, 0.0, 1.0)
    for row in range(rows):
        roughness = least + (1.0 - least) * row / (rows - 1)
        for column in range(columns):
            view = max((column / (columns - 1)) ** 2, 1e-4)
            back = (math.sqrt(1.0 - view * view), 0.0, view)
            total = 0.0
            for i in range(_HEIGHTS):
                root = (i + 0.5) / _HEIGHTS  # of the cosine: most light is at grazing angles
                z = root * root
                radius = math.sqrt(1.0 - z * z)
                for k in range(_AZIMUTHS):
                    angle = math.pi * (k + 0.5) / _AZIMUTHS
                    toward = (radius * math.cos(angle), radius * math.sin(angle), z)
                    total += root * eval_sheen(roughness * roughness, upward, back, toward)
            albedos[row, column] = total * 4.0 * math.pi / (_HEIGHTS * _AZIMUTHS)


@cache
def sheen_table() -> NDArray[np.float32]:
    """Shares of light that white fibres reflect; see `integrate_sheen`."""
    albedos = np.empty((_ROWS, _COLUMNS), np.float32)
    integrate_sheen(LEAST_SHEEN, albedos)
    return albedos


@device
def _between(table, at, across):
    first, second = gather(np.float32, table, at), gather(np.float32, table, as_int32(at + _1))
    return first + (second - first) * across


@device
def sheen_albedo(table, cosine, roughness):
    """Look up the share of light that white fibres reflect to a viewer.

    Parameters
    ----------
    table : uint64
        Address of `sheen_table`'s array.
    cosine, roughness : float64
        At most 1.
    """
    x = as_float32(square_root(maximum(cosine, _NULL)) * _LAST_COLUMN)
    y = as_float32(maximum(roughness - _LEAST, _NULL) * _ROWS_PER_ROUGHNESS)
    # The last row and column are reached from the ones before them.
    left = floor(minimum(x, _LAST_COLUMN - _HALF))
    top = floor(minimum(y, np.float32(_ROWS - 1) - _HALF))
    at = as_int32(as_int32(top) * _WIDTH + as_int32(left))
    above, below = _between(table, at, x - left), _between(table, as_int32(at + _WIDTH), x - left)
    return widen_number(above + (below - above) * (y - top))
