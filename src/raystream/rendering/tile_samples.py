"""Samples of tiles: tracing the units of a pass on all threads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress, parallel_for
from raystream.rendering.adaptive import TILE, Tiles, Unit
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.shading.aovs import AovBuffers

__all__ = ["Sampled", "trace_units"]

#: A sample of some pixels: its light, and its AOVs.
Sampled = tuple[NDArray[np.float32], AovBuffers | None]

#: Most pixels of the rows of a band, since rays are generated for whole rows: 25 MB.
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
    bands: list[tuple[int, int, NDArray[np.int64]]] = []  # unit, first row of its result, tiles
    path_count = 0
    for number, (_, chosen) in enumerate(units):
        first = 0
        for part in _parts(tiles, chosen, context.width, band_pixels):
            bands.append((number, first, part))
            first += int(tiles.sizes[part].sum())
        aovs = AovBuffers.empty(first) if context.layers else None
        made.append((np.empty((first, 3), np.float32), aovs))
        path_count += first

    def trace(begin: int, end: int) -> None:
        for number, first, part in bands[begin:end]:
            light, aovs = made[number]
            pixels = tiles.pixels(part)
            end_row = first + len(pixels)
            own = None if aovs is None else aovs.part(first, end_row)
            light[first:end_row] = _trace(renderer, context, units[number].sample, pixels, own)

    report = None
    if progress is not None:
        whole = progress
        report = lambda done, steps: whole(path_count * done // steps, path_count)  # noqa: E731
    parallel_for(trace, len(bands), 1, report)
    return made


def _parts(
    tiles: Tiles, chosen: NDArray[np.int64], width: int, band_pixels: int
) -> Iterator[NDArray[np.int64]]:
    """Divide ascending tiles into those of bands."""
    count = max(band_pixels // TILE**2, 1)
    rows = max(MOST_SPAN // (TILE * width), 1)
    first = 0
    while first < len(chosen):
        end_row = int(chosen[first]) // tiles.columns + rows
        end = min(first + count, int(np.searchsorted(chosen, end_row * tiles.columns)))
        yield chosen[first:end]
        first = end


def _trace(
    renderer: Integrator,
    context: RenderContext,
    sample: int,
    pixels: NDArray[np.int64],
    aovs: AovBuffers | None,
) -> NDArray[np.float32]:
    """Trace one sample of some pixels, and write its AOVs."""
    width = context.width
    rows = range(int(pixels.min()) // width, int(pixels.max()) // width + 1)
    chosen = pixels - rows.start * width
    seen = None if aovs is None else AovBuffers.empty(len(rows) * width)
    light = renderer.trace(context, rows, sample, seen, chosen=chosen)
    if aovs is not None and seen is not None:
        for to, values in zip(aovs, seen, strict=True):
            to[:] = values[chosen]
    return light[chosen]
