"""Samples of an image's rows, traced in bands on all threads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress, parallel_for, part_of, thread_count
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.shading.aovs import AovBuffers

#: A sample of some rows: its light, and its AOVs.
Sampled = tuple[NDArray[np.float32], AovBuffers | None]

#: Pixels of a band: enough that rays share nodes, few enough for the threads to finish together.
#: Memory is about 300 bytes per pixel.
LEAST_BAND, MOST_BAND = 1 << 12, 1 << 16

#: Most rays that a band of more than one row may spawn at once: 110 MB.
MOST_RAYS = 1 << 21


def trace_sample(
    renderer: Integrator,
    context: RenderContext,
    sample: int,
    progress: Progress | None = None,
    rows: range | None = None,
) -> Sampled:
    """Trace one sample of every pixel, or of some rows, on all threads.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    sample : int
        Its number.
    progress : callable, optional
        Called with (pixels done, pixels).
    rows : range, optional
        Consecutive rows to trace [default: all].

    Returns
    -------
    light : ndarray of shape (R * W, 3), float32
        Linear RGB of the R rows.
    aovs : AovBuffers or None
        Of its first hits, if layers are rendered.
    """
    numbers = range(sample, sample + 1)
    light, seen = trace_samples(renderer, context, numbers, progress, rows)
    return light[0], seen[0]


def trace_samples(
    renderer: Integrator,
    context: RenderContext,
    samples: range,
    progress: Progress | None = None,
    rows: range | None = None,
) -> tuple[NDArray[np.float32], list[AovBuffers | None]]:
    """Trace samples of every pixel, or of some rows, on all threads.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    samples : range
        Their numbers.
    progress : callable, optional
        Called with (paths done, paths).
    rows : range, optional
        Consecutive rows to trace [default: all].

    Returns
    -------
    light : ndarray of shape (S, R * W, 3), float32
        Linear RGB of each sample.
    aovs : list of AovBuffers or None
        Of each sample's first hits, if layers are rendered.
    """
    rows = range(context.height) if rows is None else rows
    width, height = context.width, len(rows)
    pixel_count = width * height
    path_count = len(samples) * pixel_count
    band_count = -(-height // rows_per_band(renderer, context, height, len(samples)))
    light = np.empty((len(samples), pixel_count, 3), np.float32)
    aovs = [AovBuffers.empty(pixel_count) if context.layers else None for _ in samples]

    def trace_band(number: int, serial: Progress | None = None) -> None:
        sample, band = divmod(number, band_count)
        here = rows[height * band // band_count : height * (band + 1) // band_count]
        first = (here.start - rows.start) * width
        last = first + len(here) * width
        seen = aovs[sample]
        part = None if seen is None else seen.part(first, last)
        report = part_of(serial, sample * pixel_count + first, last - first, path_count)
        light[sample, first:last] = renderer.trace(context, here, samples[sample], part, report)

    bands = renderer.bands_of(context)
    if bands is not None and bands.is_serial:
        for number in range(len(samples) * band_count):
            trace_band(number, progress)
        return light, aovs

    def trace(begin: int, end: int) -> None:
        for number in range(begin, end):
            trace_band(number)

    report = part_of(progress, 0, path_count, path_count)
    parallel_for(trace, len(samples) * band_count, 1, report)
    return light, aovs


def rows_per_band(renderer: Integrator, context: RenderContext, rows: int, samples: int = 1) -> int:
    """Number of rows in a band, for some samples of an image of `rows` rows."""
    bands = renderer.bands_of(context)
    per_pixel = max(renderer.rays_per_pixel(context), 1)
    if bands is not None:
        pixels = bands.pixels_at_once(renderer.stages, per_pixel)
    else:
        share = -(-context.width * rows * samples // (4 * thread_count()))
        pixels = min(max(share, LEAST_BAND), MOST_BAND, MOST_RAYS // per_pixel)
    return max(1, pixels // context.width)
