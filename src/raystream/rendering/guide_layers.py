"""Layers of an image as guides of a denoiser: a constant where one is missing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.image import Image


def guide_layer(image: Image, name: str, width: int, otherwise: float) -> NDArray[np.float32]:
    """A layer, or a constant if it is missing.

    Parameters
    ----------
    image : Image
    name : str
    width : {1, 3}
        Numbers per pixel.
    otherwise : float
        The constant.

    Returns
    -------
    ndarray of shape (H, W) or (H, W, 3), float32

    Raises
    ------
    ValueError
        If the layer has another shape.
    """
    shape = image.pixels.shape[:2] if width == 1 else image.pixels.shape
    if name not in image.layers:
        return np.full(shape, otherwise, np.float32)
    layer = image.layers[name]
    if layer.shape != shape:
        raise ValueError(f"image: expected its layer {name!r} of shape {shape}, got {layer.shape}")
    return layer.astype(np.float32, copy=False)


def finite(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """A copy with 0 in place of what is not finite."""
    return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
