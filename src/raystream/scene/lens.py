"""Lens: sample points on the disk of a thin lens."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


def lens_samples(lens: ArrayLike) -> NDArray[np.float64]:
    """Check lens samples.

    Parameters
    ----------
    lens : array_like of shape S + (2,), float
        In [0, 1).

    Returns
    -------
    ndarray of shape S + (2,), float64

    Raises
    ------
    ValueError
        If the shape is wrong, or a number is not in [0, 1).
    """
    try:
        samples = np.asarray(lens, np.float64)
    except (TypeError, ValueError):
        raise ValueError("lens: expected an array of numbers in [0, 1)") from None
    if samples.ndim == 0 or samples.shape[-1] != 2:
        raise ValueError(f"lens: expected a shape that ends in 2, got {samples.shape}")
    if not ((samples >= 0.0) & (samples < 1.0)).all():
        raise ValueError("lens: expected numbers in [0, 1)")
    return samples


def disk_points(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map the unit square to the unit disk, preserving relative areas and adjacency.

    Concentric squares become concentric circles; (0.5, 0.5) is the centre.

    Parameters
    ----------
    samples : ndarray of shape S + (2,), float64
        In [0, 1).

    Returns
    -------
    ndarray of shape S + (2,), float64
        At most 1 from the origin, except for rounding.

    References
    ----------
    Shirley and Chiu, "A Low Distortion Map Between Disk and Square", Journal of Graphics
    Tools 2(3), 1997.
    """
    a, b = np.moveaxis(2.0 * samples - 1.0, -1, 0)
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)  # negative on the far sides: the angle then points away
    ratio = np.where(wide, b, a) / np.where(radius == 0.0, 1.0, radius)
    angle = math.pi / 4 * np.where(wide, ratio, 2.0 - ratio)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
