"""Samples of tiles: tracing the units of a pass on all threads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress, parallel_for
from raystream.rendering.adaptive import TILE, Tiles, Unit
from raystream.rendering.camera_paths import tile_camera_paths
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.shading.aovs import AovBuffers

__all__ = ["Sampled", "trace_units"]

#: A sample of some pixels: its light, and its AOVs.
Sampled = tuple[NDArray[np.float32], AovBuffers | None]

#: Most pixels of the rows that a band covers, whose light is an array: 3 MB.
MOST_SPAN = 1 << 18


def trace_units(
    renderer: Integrator,
    context: RenderContext,
    units: Sequence[Unit],
    band_pixels: int,
    progress: Progress | None = None,
) -> list[Sampled]:
    """Trace samples of tiles on all threads.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    units : sequence of Unit
        Of tiles.
    band_pixels : int
        About the pixels that a thread traces at once.
    progress : callable, optional
        Called with (paths done, paths).

    Returns
    -------
    list of (light, aovs)
        For each unit, rows of the pixels of its tiles, in the order of `Tiles.pixels`: ndarray
        of shape (P, 3), float32, linear RGB, and `AovBuffers` if layers are rendered.
    """
    tiles = Tiles(context.width, context.height)
    made: list[Sampled] = []
    bands: list[tuple[int, int, slice]] = []  # unit, first row of its result, its tiles
    path_count = 0
    for number, unit in enumerate(units):
        first = 0
        for part in _parts(tiles, unit.tiles, context.width, band_pixels):
            bands.append((number, first, part))
            first += int(tiles.sizes[unit.tiles[part]].sum())
        aovs = AovBuffers.empty(first) if context.layers else None
        made.append((np.empty((first, 3), np.float32), aovs))
        path_count += first

    def trace(begin: int, end: int) -> None:
        for number, first, part in bands[begin:end]:
            samples, chosen = units[number]
            band = Unit(samples[part], chosen[part])
            light, aovs = made[number]
            last = first + tiles.size_of(band)
            own = None if aovs is None else aovs.part(first, last)
            light[first:last] = _trace(renderer, context, tiles, band, own)

    report = None
    if progress is not None:
        whole = progress
        report = lambda done, steps: whole(path_count * done // steps, path_count)  # noqa: E731
    parallel_for(trace, len(bands), 1, report)
    return made


def _parts(
    tiles: Tiles, chosen: NDArray[np.int64], width: int, band_pixels: int
) -> Iterator[slice]:
    """Divide ascending tiles into those of bands, of about the same number."""
    band_count = max(round(len(chosen) * TILE**2 / max(band_pixels, TILE**2)), 1)
    rows = max(MOST_SPAN // (TILE * width), 1)
    for band in range(band_count):
        first, last = (len(chosen) * k // band_count for k in (band, band + 1))
        while first < last:
            end_row = int(chosen[first]) // tiles.columns + rows
            end = min(last, int(np.searchsorted(chosen, end_row * tiles.columns)))
            yield slice(first, end)
            first = end


def _trace(
    renderer: Integrator,
    context: RenderContext,
    tiles: Tiles,
    unit: Unit,
    aovs: AovBuffers | None,
) -> NDArray[np.float32]:
    """Trace a unit on this thread, and write its AOVs."""
    size = width, _ = context.width, context.height
    pixels, corners = tiles.pixels(unit.tiles), tiles.corners(unit.tiles)
    paths = tile_camera_paths(context.camera, size, context.sampler, corners, pixels, unit.samples)
    rows = range(int(pixels.min()) // width, int(pixels.max()) // width + 1)
    places = pixels - rows.start * width
    seen = None if aovs is None else AovBuffers.empty(len(rows) * width)
    light = renderer.trace_paths(context, rows, 0, paths, seen)
    if aovs is not None and seen is not None:
        for to, values in zip(aovs, seen, strict=True):
            to[:] = values[places]
    return light[places]
