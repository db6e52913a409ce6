"""Progressive rendering: sample by sample until limits are reached, resumable from checkpoints."""

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
from raystream.structures.bvh.kernel_choice import SMALL_BATCH

__all__ = [
    "Limits",
    "Sampled",
    "checkpoint_seconds",
    "render_samples",
    "trace_sample",
    "trace_samples",
]

#: A sample of every pixel: its light, and its AOVs; see `trace_sample`.
Sampled = tuple[NDArray[np.float32], AovBuffers | None]

#: Returns a sample of all rows, by its number: (number, progress).
TakeSample = Callable[[int, Progress | None], Sampled]

#: Pixels of a band: enough for streams of rays to be worth sorting, few enough for the threads
#: to finish together. Memory is about 300 bytes per pixel.
LEAST_BAND, MOST_BAND = 1 << 12, 1 << 16

#: Most rays that a band of more than one row may spawn at once: 110 MB.
MOST_RAYS = 1 << 21

#: Most samples that are traced at once, so that threads need not wait for each other after each:
#: half a second of them, since an interrupt discards them, and 64 MB of their light.
SAMPLES_SECONDS, SAMPLES_BYTES = 0.5, 1 << 26

#: See `checkpoint_seconds`.
CHECKPOINT_SECONDS = 10.0


@dataclass(frozen=True)
class Limits:
    """When rendering stops: at the first limit reached.

    Attributes
    ----------
    samples : int
        Per pixel.
    noise : float, optional
        Relative error of the image, see `Film.error`; tested from 8 samples on.
    seconds : float, optional
        A sample that has begun is finished. Time before an interruption does not count.
    """

    samples: int
    noise: float | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("noise", self.noise), ("time_limit", self.seconds)):
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name}: expected a number above 0, got {value}")

    @property
    def only_samples(self) -> bool:
        """Whether nothing but the number of samples ends the rendering."""
        return self.noise is None and self.seconds is None


#: Samples before their variance is meaningful.
_FIRST_SAMPLES = 8

#: Of a sample's light.
_LIGHT_BYTES = 12


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
    """Render an image.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    limits : Limits
    checkpoint : path, optional
        A file, ending in ``.npz``, to which all samples are saved every 10 seconds, at the end
        (see `SampleFile`), and when rendering is interrupted after the first of them. An existing
        one is resumed, to the same bits as without the interruption.
    on_pass : callable, optional
        Called with the image so far, every 10 seconds, after whole samples.
    progress : callable, optional
        Called with (paths done, paths), first with those of the checkpoint. With noise and time
        limits the total is an estimate until the last call. An exception that it raises ends
        the rendering.
    take : callable, optional
        Returns each sample as `trace_sample` would, with the same bits, for example from other
        machines. If it raises `RaystreamError`, the samples so far are saved as after an
        interruption.

    Returns
    -------
    Image
        With the context's layers, ``variance`` and ``samples``.

    Raises
    ------
    FileFormatError
        If the checkpoint is corrupt, or of another image.
    OSError
        If the checkpoint cannot be written.
    ValueError
        If ``RAYSTREAM_CHECKPOINT_SECONDS`` is not a number of seconds.
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
    bands = renderer.bands_of(context)
    is_serial = bands is not None and bands.is_serial
    if take is None and sample < limits.samples and not is_serial:
        _compile(renderer, context, sample)
    if bands is not None:
        bands.start()
    # Samples are traced one by one where another may not be needed, or each is asked for.
    at_once = take is None and not context.layers and not is_serial and limits.only_samples
    seconds = math.inf  # of a sample
    shown = time.monotonic()
    try:
        # Ctrl-C reaches this thread only. Another thread, which the block joins, never leaves
        # half of a sample in the sums.
        with ThreadPoolExecutor(1) as adder:
            adder.submit(int).result()  # only a started thread is joined
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
                begun = time.monotonic()  # without the checkpoint
                report = part_of(progress, sample * pixel_count, expected * pixel_count)
                count = 1
                if at_once:
                    count = _samples_at_once(expected - sample, pixel_count, seconds, interval)
                    numbers = range(sample, sample + count)
                    light, aovs = trace_samples(renderer, context, numbers, report), None
                elif take is None:
                    light, aovs = trace_sample(renderer, context, sample, report)
                else:
                    light, aovs = take(sample, report)
                adder.submit(_add, sums, context.layers, light, aovs).result()
                sample += count
                seconds = (time.monotonic() - begun) / count
    except (KeyboardInterrupt, RaystreamError):
        if file is not None and sums.counts.any():
            file.save(sums)
        raise
    if file is not None:
        file.finish(sums, time.monotonic() - shown >= interval)
    more = {} if bands is None else bands.figures()
    return sums.image({"samples": sample, "error": sums.error(), **more})


def _compile(renderer: Integrator, context: RenderContext, sample: int) -> None:
    """Trace a few rows and discard them, to compile kernels on this thread.

    See `parallel_for` for the reason. Except in small images the rows make a large batch, as the
    image's bands do: a small one may select another kernel, which would be compiled for this
    call alone.
    """
    count = 1
    if context.width * context.height > SMALL_BATCH:
        count = SMALL_BATCH // context.width + 1
    rows = range(min(count, _rows_per_band(renderer, context, context.height)))
    aovs = AovBuffers.empty(len(rows) * context.width) if context.layers else None
    renderer.trace(context, rows, sample, aovs)


def checkpoint_seconds() -> float:
    """Seconds between two checkpoints, and between two calls of `on_pass`.

    The value of ``RAYSTREAM_CHECKPOINT_SECONDS`` [default: `CHECKPOINT_SECONDS`]; 0 means after
    every sample.

    Raises
    ------
    ValueError
        If the variable is not a finite number of at least 0.
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
    """Estimate the samples that the image will have; at most `sample` once it is complete.

    Parameters
    ----------
    sums : Film
    first, sample : int
        Number of samples at the start, and now.
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
        expected = min(expected, sample * ratio * ratio)  # 4x the samples halve the error
    return min(limits.samples, max(math.ceil(expected), sample + 1))


def _samples_at_once(left: int, pixel_count: int, seconds: float, interval: float) -> int:
    """Number of samples to trace at once, of those that are left.

    Parameters
    ----------
    left, pixel_count : int
    seconds : float
        That a sample takes, 0 if the clock did not advance; inf for unknown.
    interval : float
        See `checkpoint_seconds`.
    """
    most = min(SAMPLES_SECONDS, interval) / max(seconds, 1e-9)
    fitting = SAMPLES_BYTES // (pixel_count * _LIGHT_BYTES)
    return max(1, min(left, fitting, int(most)))


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
    rows = range(context.height) if rows is None else rows
    aovs = AovBuffers.empty(context.width * len(rows)) if context.layers else None
    light = _trace_bands(renderer, context, range(sample, sample + 1), rows, progress, aovs)
    return light[0], aovs


def trace_samples(
    renderer: Integrator,
    context: RenderContext,
    samples: range,
    progress: Progress | None = None,
) -> NDArray[np.float32]:
    """Trace samples of every pixel on all threads, without layers.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    samples : range
        Their numbers.
    progress : callable, optional
        Called with (paths done, paths).

    Returns
    -------
    ndarray of shape (S, H * W, 3), float32
        Linear RGB of each sample.
    """
    return _trace_bands(renderer, context, samples, range(context.height), progress)


def _trace_bands(
    renderer: Integrator,
    context: RenderContext,
    samples: range,
    rows: range,
    progress: Progress | None = None,
    aovs: AovBuffers | None = None,
) -> NDArray[np.float32]:
    """Samples of some rows, see `trace_samples`; and the AOVs of a single one."""
    width, height = context.width, len(rows)
    pixel_count = width * height
    path_count = len(samples) * pixel_count
    band_count = -(-height // _rows_per_band(renderer, context, height, len(samples)))
    light = np.empty((len(samples), pixel_count, 3), np.float32)

    def trace_band(number: int, serial: Progress | None = None) -> None:
        sample, band = divmod(number, band_count)
        here = rows[height * band // band_count : height * (band + 1) // band_count]
        first = (here.start - rows.start) * width
        last = first + len(here) * width
        part = None if aovs is None else aovs.part(first, last)
        report = part_of(serial, sample * pixel_count + first, path_count)
        light[sample, first:last] = renderer.trace(context, here, samples[sample], part, report)

    bands = renderer.bands_of(context)
    if bands is not None and bands.is_serial:
        for number in range(len(samples) * band_count):
            trace_band(number, progress)
        return light

    def trace(begin: int, end: int) -> None:
        for number in range(begin, end):
            trace_band(number)

    report = None
    if progress is not None:
        whole = progress
        report = lambda done, steps: whole(path_count * done // steps, path_count)  # noqa: E731
    parallel_for(trace, len(samples) * band_count, 1, report)
    return light


def _rows_per_band(
    renderer: Integrator, context: RenderContext, rows: int, samples: int = 1
) -> int:
    """Number of rows in a band, for some samples of an image of `rows` rows."""
    bands = renderer.bands_of(context)
    per_pixel = max(renderer.rays_per_pixel(context), 1)
    if bands is not None:
        pixels = bands.pixels_at_once(renderer.stages, per_pixel)
    else:
        share = -(-context.width * rows * samples // (4 * thread_count()))
        pixels = min(max(share, LEAST_BAND), MOST_BAND, MOST_RAYS // per_pixel)
    return max(1, pixels // context.width)


def _add(
    sums: Film,
    layers: Sequence[str],
    light: NDArray[np.float32],
    aovs: AovBuffers | None,
) -> None:
    """Add samples of every pixel to the film, with the layers of a single one."""
    sums.add_samples(0, light)
    for name in layers:
        sums.set_layer(name, 0, getattr(aovs, name))
