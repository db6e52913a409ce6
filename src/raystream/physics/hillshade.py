"""Slopes of elevation rasters, and their brightness in sunlight."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from raystream.physics.elevation import Elevation


def direction_to_sun(azimuth: float, altitude: float) -> NDArray[np.float64]:
    """Unit vector towards the sun, shape (3,), float64: x is east, y north, z up.

    Parameters
    ----------
    azimuth : float
        Degrees clockwise from north.
    altitude : float
        Degrees above the horizon.
    """
    turn, rise = math.radians(azimuth), math.radians(altitude)
    level = math.cos(rise)
    return np.array([level * math.sin(turn), level * math.cos(turn), math.sin(rise)])


def brightness(elevation: Elevation, rows: slice, sun: NDArray[np.float64]) -> NDArray[np.float32]:
    """Cosine of the angle between sun and surface, 0 where it faces away; NaN without slope.

    Parameters
    ----------
    elevation : Elevation
    rows : slice
        The rows to compute.
    sun : ndarray of shape (3,), float64

    Returns
    -------
    ndarray of shape (rows, W), float32
    """
    height_count = len(elevation.y)
    first, stop = max(0, rows.start - 1), min(height_count, rows.stop + 1)
    part = elevation.heights[first:stop]
    inner = slice(rows.start - first, rows.stop - first)
    along_x = _slopes(part[inner].T, elevation.x).T
    along_y = _slopes(part, elevation.y[first:stop])[inner]
    cosine = sun[2] - sun[0] * along_x - sun[1] * along_y
    cosine /= np.sqrt(1.0 + along_x**2 + along_y**2)
    return np.maximum(cosine, 0.0).astype(np.float32)


def _slopes(heights: NDArray[np.float64], axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """Slopes along the first axis, of the parabola through three neighbours.

    Of the line through two where the third is missing; NaN where both are, or the cell itself.
    """
    steps = np.diff(axis)[:, None]
    between = np.diff(heights, axis=0) / steps
    missing = np.full((1, heights.shape[1]), np.nan)
    ahead, behind = np.concatenate([between, missing]), np.concatenate([missing, between])
    lengths = np.abs(steps)
    outside = np.ones((1, 1))
    # Each side counts by the length of the other.
    weight_ahead = np.concatenate([outside, lengths])
    weight_behind = np.concatenate([lengths, outside])
    weight_ahead = np.where(np.isnan(ahead), 0.0, weight_ahead)
    weight_behind = np.where(np.isnan(behind), 0.0, weight_behind)
    with np.errstate(invalid="ignore"):
        return (np.nan_to_num(ahead) * weight_ahead + np.nan_to_num(behind) * weight_behind) / (
            weight_ahead + weight_behind
        )
