"""Colors: conversion from sRGB to linear."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def srgb_to_linear(encoded: ArrayLike) -> NDArray[np.float32]:
    """Decode sRGB.

    Parameters
    ----------
    encoded : array_like of any shape, float
        Clamped to [0, 1]; NaN becomes 0.

    Returns
    -------
    ndarray of the same shape, float32

    References
    ----------
    IEC 61966-2-1.
    """
    values = np.clip(np.nan_to_num(np.asarray(encoded, np.float64), nan=0.0), 0.0, 1.0)
    low = values / 12.92
    high = ((values + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, low, high).astype(np.float32)


def byte_colors_to_linear(encoded: NDArray[Any]) -> NDArray[np.float32]:
    """Decode sRGB bytes by table: as `srgb_to_linear`, for integers in 0 .. 255."""
    table = srgb_to_linear(np.arange(256) / 255.0)
    places = np.clip(np.nan_to_num(encoded), 0, 255).astype(np.uint8)
    return np.take(table, places)
