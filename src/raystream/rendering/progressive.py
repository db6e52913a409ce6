"""Progressive rendering: sample by sample until limits are reached, resumable from checkpoints."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.jit.threads import Progress
from raystream.rendering.film import Film
from raystream.rendering.image import Image
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.limits import FIRST_SAMPLES, Limits, Pace
from raystream.rendering.sample_bands import Sampled, rows_per_band, trace_samples
from raystream.rendering.sample_file import SampleFile
from raystream.rendering.shading.aovs import AovBuffers
from raystream.structures.bvh.batches import SMALL_BATCH

#: Most samples that are traced at once, so that threads need not wait for each other after each:
#: half a second of them, since an interrupt discards them, and 64 MB of their light and layers.
SAMPLES_SECONDS, SAMPLES_BYTES = 0.5, 1 << 26

#: See `checkpoint_seconds`.
CHECKPOINT_SECONDS = 10.0


class SampleSource(Protocol):
    """Traces samples in place of this process, with the same bits."""

    def take(self, sample: int, progress: Progress | None) -> Sampled:
        """Return a sample of the whole image, as `trace_sample` would; they are taken in order."""
        ...


#: Of a sample's light, and of its AOVs.
_LIGHT_BYTES, _AOV_BYTES = 12, 44


def render_samples(
    renderer: Integrator,
    context: RenderContext,
    limits: Limits,
    *,
    checkpoint: str | PathLike[str] | None = None,
    on_pass: Callable[[Image], object] | None = None,
    progress: Progress | None = None,
    source: SampleSource | None = None,
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
        Called with the image so far and its ``samples`` and ``error``, every 10 seconds, after
        whole samples of the image.
    progress : callable, optional
        Called with (paths done, paths), first with those of the checkpoint. With noise and time
        limits the total is an estimate until the last call, which counts the paths of the image
        only: fewer than the call before if some were beyond the noise limit. An exception that it
        raises ends the rendering.
    source : SampleSource, optional
        Traces the samples in place of this process, for example on other machines. If it
        raises `RaystreamError`, the samples so far are saved as after an interruption.

    Returns
    -------
    Image
        With the context's layers, ``variance`` and ``samples``. Its figures are ``samples``
        per pixel; ``error``, see `Film.error`; and those of the context's `DeviceBands`.

    Raises
    ------
    FileFormatError
        If the checkpoint cannot be used, see `SampleFile.open`.
    OSError
        If the checkpoint cannot be written.
    ValueError
        If ``RAYSTREAM_CHECKPOINT_SECONDS`` is not a number of seconds.
    """
    interval = checkpoint_seconds()
    file = None
    if checkpoint is not None:
        file = checkpoint if isinstance(checkpoint, SampleFile) else SampleFile(checkpoint)
    kept = None if file is None else file.open(renderer, context)
    sums = Film(context.width, context.height) if kept is None else kept
    first = int(sums.counts.sum())
    started = time.monotonic()
    passes = _Passes(renderer, context, limits, sums, source)
    passes.start()
    shown = time.monotonic()
    try:
        # Ctrl-C reaches this thread only. Another thread, which the block joins, never leaves
        # half of a pass in the sums.
        with ThreadPoolExecutor(1) as adder:
            adder.submit(int).result()  # only a started thread is joined
            while True:
                now = time.monotonic()
                done = int(sums.counts.sum())
                # Time ends an image, but what is traced is added.
                pace = None if passes.ahead else Pace(first, now - started, passes.seconds_per_path)
                expected = limits.expected_paths(sums, pace)
                if progress is not None and (done >= expected or not passes.ahead):
                    progress(done, expected)
                if done >= expected:
                    break
                if done and now - shown >= interval:
                    if file is not None:
                        file.save(sums)
                    if on_pass is not None:
                        on_pass(sums.image(_figures(sums)))
                    shown = time.monotonic()
                if not passes.ahead:
                    left = expected - done
                    passes.trace(left, interval, _within(progress, done, expected))
                passes.add(adder)
    except (KeyboardInterrupt, RaystreamError):
        if file is not None and sums.counts.any():
            file.save(sums)
        raise
    if file is not None:
        file.finish(sums, time.monotonic() - shown >= interval)
    bands = passes.bands
    more = {} if bands is None else bands.figures()
    return sums.image({**_figures(sums), **more})


def _within(progress: Progress | None, done: int, expected: int) -> Progress | None:
    """Progress callback of a pass, which may have more paths than expected."""
    if progress is None:
        return None
    whole = progress
    return lambda more, _: whole(min(done + more, expected), expected)


#: One sample of the image, or several without AOVs, to add to the sums.
_Traced = tuple[NDArray[np.float32], AovBuffers | None]


class _Passes:
    """Traces the samples that an image needs next.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
    limits : Limits
    sums : Film
        The samples so far.
    source : SampleSource, optional

    Attributes
    ----------
    bands : DeviceBands or None
    ahead : deque
        Passes that are traced and not yet added to the film, in the order to add them.
    seconds_per_path : float
        The least so far, for a start or a disturbance does not count; inf before the first passes,
        and where others may have traced them before they were asked for, or compile meanwhile.
    """

    def __init__(
        self,
        renderer: Integrator,
        context: RenderContext,
        limits: Limits,
        sums: Film,
        source: SampleSource | None,
    ) -> None:
        self._renderer, self._context, self._limits = renderer, context, limits
        self._sums, self._source = sums, source
        self.bands = renderer.bands_of(context)
        self.ahead: deque[_Traced] = deque()
        self._is_serial = self.bands is not None and self.bands.is_serial
        self.seconds_per_path = math.inf
        self._paths, self._seconds = 0, 0.0  # of the passes ahead, and to trace and add them

    def start(self) -> None:
        """Begin the image: compile its kernels."""
        fewest = int(self._sums.counts.min())
        compiles = self._source is None and not self._is_serial
        if compiles and fewest < self._limits.samples:
            _compile(self._renderer, self._context, fewest)
        if self.bands is not None:
            self.bands.start()

    def trace(self, left: int, interval: float, progress: Progress | None) -> None:
        """Trace the next pass, a sample of the image; or several at once.

        Parameters
        ----------
        left : int
            Paths that the image needs, at most or by an estimate.
        interval : float
            See `checkpoint_seconds`.
        progress : callable, optional
            Called with (paths done, paths).
        """
        taken, count = int(self._sums.counts.min()), 1
        begun = time.monotonic()
        if self._source is not None:
            self.ahead.append(self._source.take(taken, progress))
        else:
            most = self._limits.samples
            if self._limits.noise is not None and taken < FIRST_SAMPLES:
                most = min(most, FIRST_SAMPLES)  # more may be beyond the noise limit
            count = min(self._count_at_once(left, interval), most - taken)
            numbers = range(taken, taken + count)
            light, aovs = trace_samples(self._renderer, self._context, numbers, progress)
            if self._limits.only_samples and not self._context.layers:
                self.ahead.append((light, None))
            else:
                self.ahead.extend(zip(light, aovs, strict=True))
        self._paths = count * len(self._sums.counts)
        self._seconds = time.monotonic() - begun

    def add(self, adder: ThreadPoolExecutor) -> None:
        """Add the next of the passes ahead to the film, on another thread."""
        begun = time.monotonic()
        adder.submit(_add, self._sums, self._context.layers, self.ahead.popleft()).result()
        self._seconds += time.monotonic() - begun
        is_measured = self._source is None and not self._is_serial
        if is_measured and not self.ahead:
            self.seconds_per_path = min(self.seconds_per_path, self._seconds / self._paths)

    def _count_at_once(self, left: int, interval: float) -> int:
        """Number of passes to trace at once."""
        if self._is_serial:
            return 1
        pixel_count = len(self._sums.counts)
        size = pixel_count * (_LIGHT_BYTES + (_AOV_BYTES if self._context.layers else 0))
        seconds = pixel_count * self.seconds_per_path
        return _passes_at_once(round(left / pixel_count), size, seconds, interval)


def _figures(sums: Film) -> dict[str, Any]:
    return {"samples": int(sums.counts.min()), "error": sums.error()}


def _compile(renderer: Integrator, context: RenderContext, sample: int) -> None:
    """Trace a few rows and discard them, to compile kernels on this thread.

    See `parallel_for` for the reason. Except in small images the rows make a large batch, as the
    image's bands do: a small one may select another kernel, which would be compiled for this
    call alone.
    """
    count = 1
    if context.width * context.height > SMALL_BATCH:
        count = SMALL_BATCH // context.width + 1
    rows = range(min(count, rows_per_band(renderer, context, context.height)))
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


def _passes_at_once(left: int, size: int, seconds: float, interval: float) -> int:
    """Number of passes to trace at once, of those that are left.

    Parameters
    ----------
    left : int
    size : int
        Of a pass, in bytes.
    seconds : float
        That a pass takes, 0 if the clock did not advance; inf for unknown.
    interval : float
        See `checkpoint_seconds`.
    """
    most = min(SAMPLES_SECONDS, interval) / max(seconds, 1e-9)
    return max(1, min(left, SAMPLES_BYTES // size, int(most)))


def _add(sums: Film, layers: Sequence[str], traced: _Traced) -> None:
    """Add samples to the film, with the layers of a single one."""
    light, aovs = traced
    sums.add_samples(0, light)
    for name in layers:
        sums.set_layer(name, 0, getattr(aovs, name))
