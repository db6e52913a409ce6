"""Conversion between linear colours and sRGB bytes, and luminance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Weights of linear RGB in luminance (sRGB primaries).
LUMINANCE = (0.2126, 0.7152, 0.0722)

# Encoded bytes for linear values in steps of 1/4095 would be too coarse near black, where
# sRGB's slope is 12.92; 2**14 steps are within half a byte's step everywhere.
_STEPS = 1 << 14
_LINEAR = np.arange(_STEPS + 1) / _STEPS
_ENCODED = np.rint(
    255.0
    * np.where(
        _LINEAR <= 0.0031308,
        12.92 * _LINEAR,
        1.055 * np.maximum(_LINEAR, 1e-9) ** (1 / 2.4) - 0.055,
    )
).astype(np.uint8)


def encode_srgb(linear: NDArray[Any], exposure: float = 1.0) -> NDArray[np.uint8]:
    """Encode linear colours as sRGB bytes.

    Parameters
    ----------
    linear : ndarray of any shape, float
        0 is black, 1 / exposure is 255; NaN becomes black.
    exposure : float
        Factor before encoding.

    Returns
    -------
    ndarray of the same shape, uint8

    References
    ----------
    IEC 61966-2-1:1999 (sRGB).
    """
    from raystream.rendering.srgb_encoding import encode  # compiled: only encoding needs Numba

    numbers = np.ascontiguousarray(linear, np.float32)
    encoded = encode(numbers.ravel(), np.float32(exposure * _STEPS), _ENCODED)
    return encoded.reshape(numbers.shape)


_BYTES = np.arange(256) / 255.0
_DECODED = np.where(_BYTES <= 0.04045, _BYTES / 12.92, ((_BYTES + 0.055) / 1.055) ** 2.4).astype(
    np.float32
)


def decode_srgb(encoded: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Decode sRGB bytes to linear values in [0, 1], of the same shape, float32."""
    return _DECODED[encoded]


def luminance(linear: NDArray[Any]) -> NDArray[Any]:
    """Luminance of linear colours, shape (..., 3): shape (...), same dtype."""
    weights = np.array(LUMINANCE, linear.dtype)
    return linear @ weights
