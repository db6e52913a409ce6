"""compare: errors of an image against a reference, as numbers and in false colours."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.color import encode_srgb, luminance
from raystream.rendering.false_colors import check_maximum, color_ramp
from raystream.rendering.scale_bar import draw_scale

__all__ = ["Comparison", "compare", "draw_difference"]

#: Keeps relative errors of dark pixels bounded; after Rousselle et al. 2011.
_DARK = 0.01

#: Anchor colours in sRGB: of brighter pixels, and of darker ones.
_WARM = ((0, 0, 0), (72, 22, 8), (150, 52, 12), (222, 104, 30), (244, 168, 92), (255, 236, 214))
_COLD = ((0, 0, 0), (8, 28, 72), (14, 66, 140), (36, 122, 200), (112, 182, 236), (218, 242, 255))

#: Of pixels that are not finite in one of the images (linear RGB), in none of the ramps.
_INVALID = (0.0, 0.6, 0.0)


@dataclass(frozen=True)
class Comparison:
    """Errors of an image against a reference, over pixels and channels of linear RGB.

    Attributes
    ----------
    rmse : float
        Root of the mean of (a - b)².
    mean_relative_error : float
        Mean of ``abs(a - b) / (abs(b) + 0.01)``.
    relative_mse : float
        Mean of (a - b)² / (b² + 0.01) [1]_.
    psnr : float
        Peak signal-to-noise ratio in decibels, of the images as sRGB bytes with the peak
        255: the difference that a screen shows. Infinite if it shows none.
    max_error : float
        Largest ``abs(a - b)``.
    max_error_at : (int, int)
        Column and row of its pixel, from the upper left; the first one on ties.
    mean, reference_mean : float
        Of each image.
    bias : float
        ``mean - reference_mean``.
    invalid_count : int
        Pixels that are not finite in one of the images; all other figures exclude them.

    References
    ----------
    .. [1] Rousselle, Knaus and Zwicker, "Adaptive Sampling and Reconstruction using Greedy
       Error Minimization", SIGGRAPH Asia 2011.
    """

    rmse: float
    mean_relative_error: float
    relative_mse: float
    psnr: float
    max_error: float
    max_error_at: tuple[int, int]
    mean: float
    reference_mean: float
    bias: float
    invalid_count: int


def compare(pixels: NDArray[np.float32], reference: NDArray[np.float32]) -> Comparison:
    """Measure errors of pixels: see `Image.compare`."""
    is_valid = _check(pixels, reference)
    a, b = (one[is_valid].astype(np.float64) for one in (pixels, reference))
    if len(a) == 0:
        raise ValueError("image: no pixel is finite both in it and in the reference")
    errors = np.abs(a - b)
    worst = int(np.argmax(errors.max(axis=1)))
    row, column = divmod(int(np.flatnonzero(is_valid)[worst]), pixels.shape[1])
    squares = errors * errors
    return Comparison(
        rmse=math.sqrt(squares.mean()),
        mean_relative_error=float((errors / (np.abs(b) + _DARK)).mean()),
        relative_mse=float((squares / (b * b + _DARK)).mean()),
        psnr=_psnr(encode_srgb(a), encode_srgb(b)),
        max_error=float(errors.max()),
        max_error_at=(column, row),
        mean=float(a.mean()),
        reference_mean=float(b.mean()),
        bias=float((a - b).mean()),
        invalid_count=int(np.count_nonzero(~is_valid)),
    )


def draw_difference(
    pixels: NDArray[np.float32], reference: NDArray[np.float32], maximum: float | None
) -> NDArray[Any]:
    """Draw errors of pixels: see `Image.draw_difference`."""
    is_valid = _check(pixels, reference)
    check_maximum(maximum)
    difference = np.zeros(is_valid.shape)
    a, b = (one[is_valid].astype(np.float64) for one in (pixels, reference))
    difference[is_valid] = luminance(a - b)
    most = float(np.abs(difference).max())
    top = float(maximum or most or 1.0)
    warm, cold = color_ramp(anchors=_WARM), color_ramp(anchors=_COLD)
    levels = np.minimum(np.abs(difference) / top, 1.0) * (len(warm) - 1)
    places = np.rint(levels).astype(np.int32)
    drawn = np.where((difference > 0.0)[..., None], warm[places], cold[places])
    drawn[~is_valid] = _INVALID
    width = pixels.shape[1]
    scales = [
        draw_scale(width, top, most > top, title, ramp)
        for title, ramp in (("brighter by", warm), ("darker by", cold))
    ]
    return np.concatenate([drawn, *scales])


def _check(pixels: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Mask of pixels that are finite in both images: shape (H, W)."""
    if pixels.shape != reference.shape:
        sizes = " and ".join(f"{one.shape[1]}x{one.shape[0]}" for one in (pixels, reference))
        raise ValueError(f"reference: expected images of equal size, got {sizes}")
    is_finite = np.isfinite(pixels) & np.isfinite(reference)
    return np.asarray(is_finite.all(axis=2))


def _psnr(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    mean_square = float(np.mean((a.astype(np.float64) - b) ** 2))
    return 10.0 * math.log10(255.0**2 / mean_square) if mean_square > 0.0 else math.inf
