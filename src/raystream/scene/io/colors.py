"""Colors: from the encoded values in files to the linear values of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["byte_colors_to_linear", "srgb_to_linear"]


def srgb_to_linear(encoded: ArrayLike) -> NDArray[np.float32]:
    """Decode sRGB.

    Parameters
    ----------
    encoded : array_like of any shape, float
        1 is full; what lies outside [0, 1] is clamped, and NaN becomes 0.

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
    """Decode sRGB bytes: the same for whole numbers in 0 .. 255, by table."""
    table = srgb_to_linear(np.arange(256) / 255.0)
    places = np.clip(np.nan_to_num(encoded), 0, 255).astype(np.uint8)
    return np.take(table, places)
