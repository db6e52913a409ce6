"""False colours: counts mapped to a colour ramp, with a scale bar.

The ramp goes from black through blue, red and yellow to nearly white. Its lightness (CIE L*) is
linear: larger counts are always lighter, also in greyscale and for colour-blind readers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.rendering.color import LUMINANCE, decode_srgb
from raystream.rendering.scale_bar import draw_scale

#: Anchor colours in sRGB, positioned by their lightness.
_ANCHORS = (
    (0, 0, 0),
    (26, 16, 66),
    (56, 26, 108),
    (96, 30, 128),
    (142, 34, 130),
    (190, 50, 108),
    (226, 76, 76),
    (244, 116, 48),
    (250, 164, 44),
    (250, 214, 84),
    (255, 252, 232),
)

_LEVELS = 1024


def color_ramp(
    level_count: int = _LEVELS, anchors: Sequence[tuple[int, int, int]] = _ANCHORS
) -> NDArray[np.float32]:
    """The ramp's colours, evenly spaced in lightness.

    Parameters
    ----------
    level_count : int
        At least 2.
    anchors : sequence of (int, int, int)
        Colours from black on, sRGB bytes, each lighter than the previous one.

    Returns
    -------
    ndarray of shape (level_count, 3), float32
        Linear RGB, from 0 to the top of the scale.

    References
    ----------
    CIE 15:2004, lightness L*.
    """
    colors = decode_srgb(np.array(anchors, np.uint8)).astype(np.float64)
    places = _lightness(colors @ LUMINANCE)
    wanted = np.linspace(0.0, places[-1], level_count)
    mixed = np.stack([np.interp(wanted, places, channel) for channel in colors.T], axis=1)
    # Mixtures of linear colours are too light: scale them to the wanted lightness.
    luminance = np.maximum(mixed @ LUMINANCE, 1e-9)
    return (mixed * (_luminance(wanted) / luminance)[:, None]).astype(np.float32)


def draw_counts(
    counts: ArrayLike, title: str = "", maximum: float | None = None
) -> NDArray[np.float32]:
    """Draw counts in false colours, with a scale bar below.

    Parameters
    ----------
    counts : array_like of shape (H, W), real
        Not negative.
    title : str
        Of the scale bar, wrapped if the image is narrow.
    maximum : float, optional
        Top of the scale [default: the largest count]. Larger counts are clamped, and the scale
        bar says so.

    Returns
    -------
    ndarray of shape (H + S, W, 3), float32
        Linear RGB: the counts, and S rows of scale bar. S depends on the width and the title.

    Raises
    ------
    ValueError
        If the shape is wrong, a count is negative, NaN or infinite, or `maximum` is not a
        number above 0.
    """
    counts = np.asarray(counts)
    if counts.ndim != 2 or 0 in counts.shape:
        raise ValueError(f"counts: expected shape (H, W), got {counts.shape}")
    most = float(counts.max())
    if not (math.isfinite(most) and counts.min() >= 0):
        raise ValueError("counts: expected numbers that are finite and not negative")
    check_maximum(maximum)
    top = float(maximum or most or 1.0)
    levels = np.divide(counts, top, dtype=np.float64)
    np.minimum(levels, 1.0, out=levels)
    levels *= _LEVELS - 1
    ramp = color_ramp()
    drawn = ramp[np.rint(levels, out=levels).astype(np.int32)]
    scale = draw_scale(counts.shape[1], top, most > top, title, ramp)
    return np.concatenate([drawn, scale])


def check_maximum(maximum: float | None) -> None:
    """Raise ValueError if it is not a finite number above 0, or None."""
    if maximum is not None and not (math.isfinite(maximum) and maximum > 0.0):
        raise ValueError(f"maximum: expected a number above 0, got {maximum}")


def _lightness(luminance: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIE L*, 0 to 100."""
    steep = 116.0 * np.cbrt(luminance) - 16.0
    return np.where(luminance > (6 / 29) ** 3, steep, luminance * (29 / 3) ** 3)


def _luminance(lightness: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of `_lightness`."""
    steep = ((lightness + 16.0) / 116.0) ** 3
    return np.where(lightness > 8.0, steep, lightness * (3 / 29) ** 3)
