"""denoise: smoothing noise, with edges from the layers of an image."""

from __future__ import annotations

import operator
from functools import partial

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.threads import parallel_for
from raystream.rendering.atrous import Guides, estimate_rows, filter_rows
from raystream.rendering.color import luminance
from raystream.rendering.image import Image

__all__ = ["denoise"]

#: Least albedo by which light is divided.
_LEAST_ALBEDO = np.float32(0.01)

#: With fewer samples, a pixel's own variance is unreliable (Schied et al. 2017, 4.2).
_LEAST_SAMPLES = 4

#: Rows per task of a thread: some milliseconds.
_ROWS = 8

#: Most passes; more would reach over 2000 pixels.
_MAX_PASSES = 10

#: With a larger strength, light would not matter.
_MAX_STRENGTH = 1e6

#: Memory per pixel: light and variance twice, guides, and temporaries.
_BYTES_PER_PIXEL = 160

#: Light is clamped to this, so that sums of squares do not overflow float32.
_MOST_LIGHT = np.float32(1e15)


def denoise(image: Image, *, passes: int, strength: float) -> Image:
    """Remove noise from an image: see `Image.denoise`."""
    passes = operator.index(passes)
    if not 1 <= passes <= _MAX_PASSES:
        raise ValueError(f"passes: expected 1 to {_MAX_PASSES}, got {passes}")
    if not 0.0 <= strength <= _MAX_STRENGTH:
        raise ValueError(f"strength: expected 0 to {_MAX_STRENGTH:g}, got {strength}")
    width, height = image.size
    check_memory(width * height * _BYTES_PER_PIXEL, f"to denoise {width}x{height} pixels would")
    pixels = np.clip(_finite(image.pixels), -_MOST_LIGHT, _MOST_LIGHT)
    albedo = np.clip(_finite(_layer(image, "albedo", 3, 1.0)), _LEAST_ALBEDO, None)
    emission = np.clip(_finite(_layer(image, "emission", 3, 0.0)), -_MOST_LIGHT, _MOST_LIGHT)
    light = (pixels - emission) / albedo
    guides = _make_guides(image, albedo)
    variance = _light_variance(image, albedo)
    parallel_for(lambda a, b: estimate_rows(a, b, guides, light, variance), height, _ROWS)
    smooth = _filter(guides, light, variance, passes, strength)
    # Add the change of the filter: where that is 0, colours keep their bits.
    changed = pixels + albedo * (smooth - light)
    layers = {name: layer for name, layer in image.layers.items() if name != "variance"}
    return Image(changed, layers, image.figures)


def _filter(
    guides: Guides,
    light: NDArray[np.float32],
    variance: NDArray[np.float32],
    passes: int,
    strength: float,
) -> NDArray[np.float32]:
    sources = light, variance
    targets = np.empty_like(light), np.empty_like(variance)
    spare = np.empty_like(light), np.empty_like(variance)
    for k in range(passes):
        run = partial(_filter_rows, 1 << k, np.float32(strength), guides, sources, targets)
        parallel_for(run, len(variance), _ROWS)
        sources, targets = targets, (spare if k == 0 else sources)
    return sources[0]


def _filter_rows(
    step: int,
    strength: np.float32,
    guides: Guides,
    sources: tuple[NDArray[np.float32], NDArray[np.float32]],
    targets: tuple[NDArray[np.float32], NDArray[np.float32]],
    begin: int,
    end: int,
) -> None:
    filter_rows(begin, end, step, strength, guides, *sources, *targets)


def _make_guides(image: Image, albedo: NDArray[np.float32]) -> Guides:
    """The layers as guides; a missing one is constant, and so has no effect."""
    normals = _finite(_layer(image, "normal", 3, 0.0))
    # Means of unit normals are shorter, and 0 where they cancel.
    lengths = np.sqrt(np.einsum("hwk,hwk->hw", normals, normals, dtype=np.float64))
    normals = (normals / np.maximum(lengths, 1e-30)[:, :, None]).astype(np.float32)
    depth = _layer(image, "depth", 1, 0.0)
    depth = np.where(np.isfinite(depth), depth, np.float32(np.inf))
    slopes = np.stack([_slope(depth, 1), _slope(depth, 0)], axis=2)
    return Guides(normals, depth, slopes, albedo)


def _slope(depth: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Change of depth from pixel to pixel.

    The smaller change of both sides: at an edge, the one on the surface.
    """
    with np.errstate(invalid="ignore"):
        steps = np.diff(depth, axis=axis)
    steps = np.where(np.isfinite(steps), steps, np.float32(np.inf))
    before = [(1, 0) if k == axis else (0, 0) for k in range(2)]
    after = [(0, 1) if k == axis else (0, 0) for k in range(2)]
    left = np.pad(steps, before, constant_values=np.inf)
    right = np.pad(steps, after, constant_values=np.inf)
    slope = np.where(np.abs(left) < np.abs(right), left, right)
    return np.where(np.isfinite(slope), slope, np.float32(0.0))


def _light_variance(image: Image, albedo: NDArray[np.float32]) -> NDArray[np.float32]:
    """Variance of the luminance of light without albedo; infinite where it is unknown.

    Channels are assumed to vary together, as under white light: deviations add up.
    """
    given = _layer(image, "variance", 3, np.inf)
    deviation = np.sqrt(np.maximum(_finite(given), 0.0)) / albedo
    with np.errstate(over="ignore"):
        variance = np.asarray(luminance(deviation) ** 2)
    enough = _layer(image, "samples", 1, _LEAST_SAMPLES) >= _LEAST_SAMPLES
    # At the edge of an emitter, samples differ because only some hit it.
    enough &= ~_layer(image, "emission", 3, 0.0).any(axis=2)
    is_known = np.isfinite(given).all(axis=2) & np.isfinite(variance) & enough
    variance[~is_known] = np.inf
    return variance


def _layer(image: Image, name: str, width: int, otherwise: float) -> NDArray[np.float32]:
    """A layer, or a constant if it is missing."""
    shape = image.pixels.shape[:2] if width == 1 else image.pixels.shape
    if name not in image.layers:
        return np.full(shape, otherwise, np.float32)
    layer = image.layers[name]
    if layer.shape != shape:
        raise ValueError(f"image: expected its layer {name!r} of shape {shape}, got {layer.shape}")
    return layer.astype(np.float32, copy=False)


def _finite(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)
