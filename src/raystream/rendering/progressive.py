"""Rendering sample by sample: until there are enough, and on from where it was broken off."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.jit.threads import Progress, parallel_for, part_of, thread_count
from raystream.rendering.film import Film
from raystream.rendering.image import Image
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.sample_file import SampleFile
from raystream.rendering.shading.aovs import AovBuffers
from raystream.structures.bvh.engine import SMALL_BATCH

__all__ = [
    "Limits",
    "Sampled",
    "TakeSample",
    "checkpoint_seconds",
    "render_samples",
    "trace_sample",
]

#: A sample of every pixel: its light, and what it sees first; see `trace_sample`.
Sampled = tuple[NDArray[np.float32], AovBuffers | None]

#: Gives the sample of a number, of all rows: (number, progress).
TakeSample = Callable[[int, Progress | None], Sampled]

#: Pixels that go through the stages together: enough for streams of rays to be worth sorting,
#: few enough for the threads to finish together. Memory is about 300 bytes for each.
LEAST_BAND, MOST_BAND = 1 << 12, 1 << 16

#: Rays that the pixels of a band may send at once, if they are of more than one row: 110 MB.
MOST_RAYS = 1 << 21

#: See `checkpoint_seconds`.
CHECKPOINT_SECONDS = 10.0


@dataclass(frozen=True)
class Limits:
    """When a picture is done: whatever comes first.

    Attributes
    ----------
    samples : int
        Of each pixel.
    noise : float, optional
        Relative error of the picture, see `Film.error`; it is looked at from 8 samples
        on.
    seconds : float, optional
        A sample that was begun is finished. Seconds before a break do not count.
    """

    samples: int
    noise: float | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("noise", self.noise), ("time_limit", self.seconds)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name}: expected a number above 0, got {value}")


#: Samples before their spread says anything.
_FIRST_SAMPLES = 8


def render_samples(
    renderer: Integrator,
    context: RenderContext,
    limits: Limits,
    *,
    checkpoint: str | PathLike[str] | None = None,
    on_pass: Callable[[Image], object] | None = None,
    progress: Progress | None = None,
    take: TakeSample | None = None,
) -> Image:
    """Render a picture.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    limits : Limits
    checkpoint : path, optional
        A file, ending in ``.npz``, to which all samples go every 10 seconds, at the end (see
        `SampleFile`), and when the rendering is interrupted after the first of them. If it is
        there already, the picture goes on from it: to the same bits as without a break.
    on_pass : callable, optional
        Called with the picture so far, every 10 seconds, after whole samples.
    progress : callable, optional
        Called with (paths done, paths): first with those that the checkpoint has. Noise and
        time limits tell only on the way how many paths there will be; the last call has the
        number that there were. An exception that it raises ends the rendering.
    take : callable, optional
        Gives each sample when its turn comes, as `trace_sample` would, with the same bits: from
        other machines, say. If it raises `RaystreamError`, the samples so far are kept as after
        an interrupt.

    Returns
    -------
    Image
        With the context's layers, ``variance`` and ``samples``.

    Raises
    ------
    FileFormatError
        If the checkpoint is damaged, or of another picture.
    OSError
        If the checkpoint cannot be written.
    ValueError
        If ``RAYSTREAM_CHECKPOINT_SECONDS`` is no number of seconds.
    """
    interval = checkpoint_seconds()
    pixel_count = context.width * context.height
    file = None
    if checkpoint is not None:
        file = checkpoint if isinstance(checkpoint, SampleFile) else SampleFile(checkpoint)
    kept = None if file is None else file.open(renderer, context)
    sums = Film(context.width, context.height) if kept is None else kept
    first = sample = int(sums.counts.min())
    started = time.monotonic()
    if take is None and sample < limits.samples:
        _compile(renderer, context, sample)
    shown = time.monotonic()
    try:
        # Ctrl-C comes to this thread only. On another one, whose end the block waits for, sums
        # are not left with half of a sample.
        with ThreadPoolExecutor(1) as adder:
            adder.submit(int).result()  # a thread that has started is waited for
            while True:
                now = time.monotonic()
                expected = _expected_samples(sums, first, sample, limits, now - started)
                if progress is not None:
                    progress(sample * pixel_count, expected * pixel_count)
                if sample >= expected:
                    break
                if sample and now - shown >= interval:
                    if file is not None:
                        file.save(sums)
                    if on_pass is not None:
                        on_pass(sums.image())
                    shown = time.monotonic()
                report = part_of(progress, sample * pixel_count, expected * pixel_count)
                light, seen = (
                    trace_sample(renderer, context, sample, report)
                    if take is None
                    else take(sample, report)
                )
                adder.submit(_add, sums, context.layers, light, seen).result()
                sample += 1
    except (KeyboardInterrupt, RaystreamError):
        if file is not None and sums.counts.any():
            file.save(sums)
        raise
    if file is not None:
        file.finish(sums, time.monotonic() - shown >= interval)
    return sums.image({"samples": sample, "error": sums.error()})


def _compile(renderer: Integrator, context: RenderContext, sample: int) -> None:
    """Trace a few rows for nothing: what they call is compiled on this thread.

    See `parallel_for` for the reason. In all but small pictures they are enough rows for a
    large batch, as the picture's bands are: a small one may take another kernel, which would
    be compiled for this call alone.
    """
    count = 1
    if context.width * context.height > SMALL_BATCH:
        count = SMALL_BATCH // context.width + 1
    rows = range(min(count, _rows_per_band(renderer, context, context.height)))
    seen = AovBuffers.empty(len(rows) * context.width) if context.layers else None
    renderer.trace(context, rows, sample, seen)


def checkpoint_seconds() -> float:
    """Seconds between two checkpoints, and between two calls of `on_pass`.

    ``RAYSTREAM_CHECKPOINT_SECONDS`` decides, else they are `CHECKPOINT_SECONDS`; 0 is after
    every sample.

    Raises
    ------
    ValueError
        If the variable is no finite number from 0 on.
    """
    text = os.environ.get("RAYSTREAM_CHECKPOINT_SECONDS", "").strip()
    if not text:
        return CHECKPOINT_SECONDS
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 <= seconds < math.inf:
        raise ValueError(f"RAYSTREAM_CHECKPOINT_SECONDS: expected seconds, got {text!r}")
    return seconds


def _expected_samples(sums: Film, first: int, sample: int, limits: Limits, seconds: float) -> int:
    """Samples that the picture will have, as far as can be told; `sample` or less: it is done.

    Parameters
    ----------
    sums : Film
    first, sample : int
        Samples that it had at the start, and has.
    limits : Limits
    seconds : float
        Since the start.
    """
    if sample >= limits.samples:
        return sample
    expected = float(limits.samples)
    if limits.seconds is not None and sample > 0:
        if seconds >= limits.seconds:
            return sample
        if sample > first:
            per_second = (sample - first) / max(seconds, 1e-9)
            expected = min(expected, first + per_second * limits.seconds)
    if limits.noise is not None and sample >= _FIRST_SAMPLES:
        error = sums.error()
        if error <= limits.noise:
            return sample
        ratio = error / limits.noise
        expected = min(expected, sample * ratio * ratio)  # four times the samples halve it
    return min(limits.samples, max(math.ceil(expected), sample + 1))


def trace_sample(
    renderer: Integrator,
    context: RenderContext,
    sample: int,
    progress: Progress | None = None,
    rows: range | None = None,
) -> Sampled:
    """Take one more sample of every pixel, or of every one of some rows, on all threads.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    sample : int
        Its number.
    progress : callable, optional
        Called with (pixels done, pixels).
    rows : range, optional
        Those to look at, one after another; all without it.

    Returns
    -------
    light : ndarray of shape (R * W, 3), float32
        Linear RGB of the R rows.
    seen : AovBuffers or None
        What it sees first, if layers are asked for.
    """
    rows = range(context.height) if rows is None else rows
    width, height = context.width, len(rows)
    band_count = -(-height // _rows_per_band(renderer, context, height))
    light: NDArray[np.float32] = np.empty((width * height, 3), np.float32)
    seen = AovBuffers.empty(width * height) if context.layers else None

    def trace(begin: int, end: int) -> None:
        for band in range(begin, end):
            here = rows[height * band // band_count : height * (band + 1) // band_count]
            first = (here.start - rows.start) * width
            last = first + len(here) * width
            part = None if seen is None else seen.part(first, last)
            light[first:last] = renderer.trace(context, here, sample, part)

    report = None
    if progress is not None:
        whole = progress
        report = lambda done, steps: whole(width * height * done // steps, width * height)  # noqa: E731
    parallel_for(trace, band_count, 1, report)
    return light, seen


def _rows_per_band(renderer: Integrator, context: RenderContext, rows: int) -> int:
    """Most of so many rows that go through the stages together."""
    bands = renderer.bands_of(context)
    per_pixel = max(renderer.rays_per_pixel(context), 1)
    if bands is not None:
        pixels = bands.pixels_at_once // per_pixel
    else:
        share = -(-context.width * rows // (4 * thread_count()))
        pixels = min(max(share, LEAST_BAND), MOST_BAND, MOST_RAYS // per_pixel)
    return max(1, pixels // context.width)


def _add(
    sums: Film,
    layers: Sequence[str],
    light: NDArray[np.float32],
    seen: AovBuffers | None,
) -> None:
    """Add a sample of every pixel to the sums."""
    sums.add_samples(0, light)
    for name in layers:
        sums.set_layer(name, 0, getattr(seen, name))
