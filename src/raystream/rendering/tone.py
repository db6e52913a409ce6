"""Tone mapping: curves that compress linear radiance to the range of a screen.

All are monotone and map 0 to 0. They return linear values, to be encoded afterwards; values above
1 are then clamped.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_choice
from raystream.rendering.color import luminance

#: Luminance that `auto_exposure` gives the mean of what is seen, and the bright parts.
_MIDDLE_GREY, _BRIGHT = 0.18, 0.9

#: Bright parts are the brightest fiftieth; pixels darker than these by this factor are not seen.
_BRIGHT_SHARE, _LEAST_SEEN = 0.98, 1e-4


def apply_tone(pixels: NDArray[Any], tone: str) -> NDArray[np.float32]:
    """Apply a tone curve.

    Parameters
    ----------
    pixels : ndarray of shape (..., 3), float
        Linear RGB. NaN and negative values count as 0, infinity as the largest float32.
    tone : str
        A name in `TONES`.

    Returns
    -------
    ndarray of the same shape, float32
        Linear RGB, finite and not negative.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    check_tone(tone)
    most = float(np.finfo(np.float32).max)
    light = np.nan_to_num(np.asarray(pixels, np.float64), nan=0.0, posinf=most, neginf=0.0)
    np.clip(light, 0.0, most, out=light)
    return TONES[tone](light).astype(np.float32)


def auto_exposure(pixels: NDArray[Any]) -> float:
    """Choose an exposure factor that shows an image.

    Parameters
    ----------
    pixels : ndarray of shape (H, W, 3), float
        Linear RGB.

    Returns
    -------
    float
        The larger of two factors: the brightest fiftieth of the pixels nearly reaches white; or the
        geometric mean of the pixels that are not black becomes middle grey (the key of [1]_), so
        that a lamp or a window in view does not darken a room. 1 for a black image.

    References
    ----------
    .. [1] Reinhard, Stark, Shirley and Ferwerda, "Photographic Tone Reproduction for Digital
       Images", SIGGRAPH 2002, equations 1 and 2.
    """
    bright = luminance(np.asarray(pixels, np.float64)).ravel()
    bright = bright[np.isfinite(bright) & (bright > 0.0)]
    if not len(bright):
        return 1.0
    most = float(np.quantile(bright, _BRIGHT_SHARE))
    seen = bright[bright > _LEAST_SEEN * most]
    key = float(np.exp(np.log(seen).mean()))
    return min(max(_BRIGHT / most, _MIDDLE_GREY / key), float(np.finfo(np.float32).max))


def check_tone(tone: str) -> None:
    """Raise ValueError if the name is unknown."""
    check_choice("tone", tone, TONES)


def _linear(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Identity."""
    return light


def _reinhard(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """The extended curve of Reinhard et al. [1]_, equation 4, on luminance; preserves hue.

    White is the image's largest luminance, and at least 1: the brightest pixel just reaches
    white, and images within the range of a screen do not change.

    References
    ----------
    .. [1] Reinhard, Stark, Shirley and Ferwerda, "Photographic Tone Reproduction for Digital
       Images", SIGGRAPH 2002.
    """
    bright = luminance(light)
    white = max(float(bright.max(initial=0.0)), 1.0)
    return light * ((1.0 + bright / white**2) / (1.0 + bright))[..., None]


def _aces(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Narkowicz's fit [1]_ of the ACES curve for film-like contrast, on each channel.

    References
    ----------
    .. [1] Narkowicz, "ACES Filmic Tone Mapping Curve", 2015.
    """
    curve = light * (2.51 * light + 0.03) / (light * (2.43 * light + 0.59) + 0.14)
    return np.minimum(curve, 1.0)


#: Tone curves by name.
TONES: dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]] = {
    "linear": _linear,
    "reinhard": _reinhard,
    "aces": _aces,
}
