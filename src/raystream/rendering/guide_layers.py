"""Layers of an image as guides of a denoiser: a constant where one is missing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Layers of an image by name.
Layers = Mapping[str, NDArray[Any]]


def guide_layer(
    layers: Layers, name: str, shape: tuple[int, ...], otherwise: float
) -> NDArray[np.float32]:
    """A layer, or a constant if it is missing.

    Parameters
    ----------
    layers : mapping of str to ndarray
        Of an image.
    name : str
    shape : tuple of int
        (H, W) or (H, W, 3).
    otherwise : float
        The constant.

    Returns
    -------
    ndarray of this shape, float32

    Raises
    ------
    ValueError
        If the layer has another shape.
    """
    if name not in layers:
        return np.full(shape, otherwise, np.float32)
    layer = layers[name]
    if layer.shape != shape:
        raise ValueError(f"image: expected its layer {name!r} of shape {shape}, got {layer.shape}")
    return layer.astype(np.float32, copy=False)


def finite(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """A copy with 0 in place of what is not finite."""
    return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
