"""The à-trous filter of an image: its guides, the variance of its light, and the passes."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import parallel_for
from raystream.rendering.atrous import (
    MARGIN,
    STRENGTH,
    Planes,
    as_planes,
    estimate_rows,
    filter_rows,
)
from raystream.rendering.color import luminance
from raystream.rendering.guide_layers import Layers, finite, guide_layer

#: Least albedo by which light is divided.
_LEAST_ALBEDO = np.float32(0.01)

#: Least factor of a firefly: infinite variance stays infinite.
_LEAST_FACTOR = np.float32(1e-30)

#: With fewer samples, a pixel's own variance is unreliable (Schied et al. 2017, 4.2).
_LEAST_SAMPLES = 4

#: Rows per task of a thread: some milliseconds.
_ROWS = 8

#: Each pass doubles the radius: five reach 62 pixels.
_PASSES = 5


def filter_with_atrous(layers: Layers, light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Filter the light of an image, guided by its layers.

    Parameters
    ----------
    layers : mapping of str to ndarray
        Of the image.
    light : ndarray of shape (H, W, 3), float32
        Linear RGB without emission; finite, at most 1e15.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        The change of light.

    Raises
    ------
    ValueError
        If a layer has the wrong shape.
    """
    albedo = np.clip(finite(guide_layer(layers, "albedo", light.shape, 1.0)), _LEAST_ALBEDO, None)
    found = light / albedo
    guides = _make_guides(layers, albedo)
    variance = _light_variance(layers, albedo)
    factor = _firefly_factors(found, variance)
    limited = found * factor[:, :, None]
    for _ in range(2):  # its square could underflow, and infinity times 0 is NaN
        variance *= factor
    return albedo * (_filter(guides, as_planes(limited, variance), light.shape[1]) - found)


def _firefly_factors(
    light: NDArray[np.float32], variance: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Factors, above 0, that make no pixel brighter than its eight neighbours.

    Only where noise explains the difference, and neighbours have any light. Without it a firefly
    keeps a part of its light: its neighbours have little variance, and reject it.
    """
    bright = np.maximum(luminance(light), np.float32(0.0))
    height, width = bright.shape
    padded = np.pad(bright, 1)
    most = np.zeros_like(bright)
    for j, i in itertools.product(range(3), repeat=2):
        if (j, i) != (1, 1):
            np.maximum(most, padded[j : j + height, i : i + width], out=most)
    is_firefly = (most > 0.0) & (bright > most) & (bright - most < STRENGTH * np.sqrt(variance))
    factors = np.divide(most, bright, out=np.ones_like(bright), where=is_firefly)
    return np.maximum(factors, _LEAST_FACTOR)


def _filter(
    guides: NDArray[np.float32], light: NDArray[np.float32], width: int
) -> NDArray[np.float32]:
    """Filter planes of light and its variance, which are overwritten; see `Planes`."""
    _, height, stride = light.shape
    filtered = np.zeros_like(light)
    at = [np.uint64(planes.ctypes.data) for planes in (guides, light, filtered)]
    planes = Planes(at[0], at[1], at[2], height, stride)
    parallel_for(lambda a, b: estimate_rows(a, b, planes), height, _ROWS)
    for k in range(_PASSES):
        parallel_for(partial(_filter_rows, 1 << k, planes), height, _ROWS)
        planes = planes._replace(light=planes.filtered, filtered=planes.light)
    found = light if _PASSES % 2 == 0 else filtered
    return found[:3, :, MARGIN : MARGIN + width].transpose(1, 2, 0)


def _filter_rows(step: int, planes: Planes, begin: int, end: int) -> None:
    filter_rows(begin, end, step, planes)


def _make_guides(layers: Layers, albedo: NDArray[np.float32]) -> NDArray[np.float32]:
    """The layers as the planes of guides; a missing one is constant, and so has no effect."""
    normals = finite(guide_layer(layers, "normal", albedo.shape, 0.0))
    # Means of unit normals are shorter, and 0 where they cancel.
    lengths = np.sqrt(np.einsum("hwk,hwk->hw", normals, normals, dtype=np.float64))
    normals = (normals / np.maximum(lengths, 1e-30)[:, :, None]).astype(np.float32)
    depth = guide_layer(layers, "depth", albedo.shape[:2], 0.0)
    depth = np.where(np.isfinite(depth), depth, np.float32(np.inf))
    return as_planes(
        normals,
        (lengths == 0.0).astype(np.float32),
        depth,
        _slope(depth, 1),
        _slope(depth, 0),
        albedo,
        np.ones_like(depth),
    )


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


def _light_variance(layers: Layers, albedo: NDArray[np.float32]) -> NDArray[np.float32]:
    """Variance of the luminance of light without albedo; infinite where it is unknown.

    Channels are assumed to vary together, as under white light: deviations add up.
    """
    given = guide_layer(layers, "variance", albedo.shape, np.inf)
    deviation = np.sqrt(np.maximum(finite(given), 0.0)) / albedo
    with np.errstate(over="ignore"):
        variance = np.asarray(luminance(deviation) ** 2)
    sample_counts = guide_layer(layers, "samples", albedo.shape[:2], _LEAST_SAMPLES)
    enough = sample_counts >= _LEAST_SAMPLES
    # At the edge of an emitter, samples differ because only some hit it.
    enough &= ~guide_layer(layers, "emission", albedo.shape, 0.0).any(axis=2)
    is_known = np.isfinite(given).all(axis=2) & np.isfinite(variance) & enough
    variance[~is_known] = np.inf
    return variance
