"""denoise: removal of the noise of a rendered image, and the choice of the filter."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.rendering.atrous import stride_of
from raystream.rendering.atrous_filter import filter_with_atrous
from raystream.rendering.color import luminance
from raystream.rendering.guide_layers import Layers, finite, guide_layer
from raystream.rendering.oidn import filter_with_oidn, has_oidn
from raystream.rendering.regional_gain import regional_gain

#: Memory per pixel of each filter, as measured with a megapixel: images, layers and buffers.
_BYTES_PER_PIXEL = {"oidn": 760, "oidn-fast": 760, "atrous": 170}

#: Light is clamped to this, so that sums of squares do not overflow float32.
_MOST_LIGHT = np.float32(1e15)

#: Filters by name: from an image's layers and its light, without emission, to the change of light.
_FILTERS: dict[str, Callable[[Layers, NDArray[np.float32]], NDArray[np.float32]]] = {
    "oidn": filter_with_oidn,
    "oidn-fast": partial(filter_with_oidn, is_fast=True),
    "atrous": filter_with_atrous,
}


def denoise(given: NDArray[np.float32], layers: Layers, method: str | None) -> NDArray[np.float32]:
    """Remove noise from the pixels of an image: see `Image.denoise`."""
    if method is None:
        method = "oidn" if has_oidn() else "atrous"
    if method not in _FILTERS:
        known = " or ".join(repr(name) for name in _FILTERS)
        raise ValueError(f"method: expected {known}, got {method!r}")
    height, width, _ = given.shape
    columns = stride_of(width) if method == "atrous" else width
    byte_count = columns * height * _BYTES_PER_PIXEL[method]
    check_memory(byte_count, f"to denoise {width}x{height} pixels would")
    pixels = np.clip(finite(given), -_MOST_LIGHT, _MOST_LIGHT)
    emission = finite(guide_layer(layers, "emission", given.shape, 0.0))
    light = pixels - np.clip(emission, -_MOST_LIGHT, _MOST_LIGHT)
    change = _FILTERS[method](layers, light)
    smooth = light + change
    gain = regional_gain(
        luminance(smooth.astype(np.float64)), -luminance(change.astype(np.float64))
    )
    # Add the changes: where they are 0, colours keep their bits.
    change += smooth * (gain - 1.0)[:, :, None].astype(np.float32)
    return pixels + change
