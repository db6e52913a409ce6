"""Progressive rendering: sample by sample until limits are reached, resumable from checkpoints."""

from __future__ import annotations

import itertools
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.jit.threads import Progress, part_of
from raystream.rendering.adaptive import FIRST_SAMPLES, Rounds, Tiles, Unit
from raystream.rendering.film import Film
from raystream.rendering.image import Image
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.limits import Limits, Pace
from raystream.rendering.sample_bands import Sampled, rows_per_band, trace_samples, trace_tiles
from raystream.rendering.sample_file import SampleFile
from raystream.rendering.shading.aovs import AovBuffers
from raystream.structures.bvh.kernel_choice import SMALL_BATCH

__all__ = ["SampleSource", "checkpoint_seconds", "render_samples"]

#: Most samples that are traced at once, so that threads need not wait for each other after each:
#: half a second of them, since an interrupt discards them, and 64 MB of their light and layers.
SAMPLES_SECONDS, SAMPLES_BYTES = 0.5, 1 << 26

#: See `checkpoint_seconds`.
CHECKPOINT_SECONDS = 10.0


class SampleSource(Protocol):
    """Traces samples in place of this process, with the same bits.

    Attributes
    ----------
    is_uniform : bool
        Whether all pixels of an image get the same number of samples.
    """

    is_uniform: bool

    def begin(self, units: Iterable[Unit], path_count: int) -> None:
        """Announce what will be taken next: units, and the number of their paths.

        Fewer may be taken than announced.
        """
        ...

    def take(self, progress: Progress | None) -> Sampled:
        """Return the next unit, as `trace_sample` or `trace_units` would."""
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
        With noise or time limits, tiles get samples where the noise is, see `adaptive.Rounds`;
        but not if the context has `DeviceBands`, which render whole rows.
    checkpoint : path, optional
        A file, ending in ``.npz``, to which all samples are saved every 10 seconds, at the end
        (see `SampleFile`), and when rendering is interrupted after the first of them. An existing
        one is resumed, to the same bits as without the interruption.
    on_pass : callable, optional
        Called with the image so far and its ``samples`` and ``error``, every 10 seconds, after
        whole passes.
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
        With the context's layers, ``variance`` and ``samples``. Its figures are ``samples``,
        the mean per pixel, an int if all are equal; ``error``, see `Film.error`; and those of the
        context's `DeviceBands`.

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
    file = None
    if checkpoint is not None:
        file = checkpoint if isinstance(checkpoint, SampleFile) else SampleFile(checkpoint)
    kept = None if file is None else file.open(renderer, context)
    sums = Film(context.width, context.height) if kept is None else kept
    first = int(sums.counts.sum())
    started = time.monotonic()
    passes = _Passes(renderer, context, limits, sums, source)
    if file is not None and not passes.tiles.fit(sums):
        raise FileFormatError(file, "holds pixels of a tile with different numbers of samples")
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


#: Samples of consecutive pixels from the first, or of some pixels, which are added to the sums.
_Traced = tuple[int | NDArray[np.int64], NDArray[np.float32], AovBuffers | None]


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
    tiles : Tiles
    bands : DeviceBands or None
    ahead : deque of list
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
        self.tiles = Tiles(context.width, context.height)
        self.bands = renderer.bands_of(context)
        self.ahead: deque[list[_Traced]] = deque()
        self._is_serial = self.bands is not None and self.bands.is_serial
        self._is_adaptive = not (limits.only_samples or context.bands is not None)
        if source is not None and source.is_uniform:
            self._is_adaptive = False
        self._rounds = Rounds(sums, limits.samples, self._is_adaptive)
        self._round: Iterator[list[Unit]] = iter(())
        self._announced = 0  # first sample of the whole image that the source does not expect
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
        """Trace the next pass, a sample of the whole image or of tiles; or several at once.

        Parameters
        ----------
        left : int
            Paths that the image needs, at most or by an estimate.
        interval : float
            See `checkpoint_seconds`.
        progress : callable, optional
            Called with (paths done, paths).
        """
        fewest, most = int(self._sums.counts.min()), int(self._sums.counts.max())
        is_whole = fewest == most and not (self._is_adaptive and fewest >= FIRST_SAMPLES)
        begun = time.monotonic()
        count = self._count_at_once(left, interval)
        if self._source is not None:
            taken = self._take_whole(fewest, progress) if is_whole else self._take_tiles(progress)
            self.ahead.append(taken)
            done = sum(light.size // 3 for _, light, _ in taken)
        elif is_whole:
            last = FIRST_SAMPLES if self._is_adaptive else self._limits.samples
            numbers = range(fewest, min(fewest + count, last))
            light, aovs = trace_samples(self._renderer, self._context, numbers, progress)
            done = len(numbers) * len(self._sums.counts)
            if self._limits.only_samples and not self._context.layers:
                self.ahead.append([(0, light, None)])
            else:
                self.ahead.extend([(0, *each)] for each in zip(light, aovs, strict=True))
        else:
            passes = [self._next_pass()]
            passes += itertools.islice(self._round, count - 1)
            units = [unit for each in passes for unit in each]
            traced = iter(trace_tiles(self._renderer, self._context, units, progress))
            for each in passes:
                self.ahead.append([(self.tiles.pixels(u.tiles), *next(traced)) for u in each])
            done = sum(self.tiles.size_of(unit) for unit in units)
        self._paths, self._seconds = done, time.monotonic() - begun

    def add(self, adder: ThreadPoolExecutor) -> None:
        """Add the next of the passes ahead to the film, on another thread."""
        begun = time.monotonic()
        adder.submit(_add, self._sums, self._context.layers, self.ahead.popleft()).result()
        self._seconds += time.monotonic() - begun
        is_measured = self._source is None and not self._is_serial
        if is_measured and not self.ahead and self._paths >= len(self._sums.counts):
            self.seconds_per_path = min(self.seconds_per_path, self._seconds / self._paths)

    def _count_at_once(self, left: int, interval: float) -> int:
        """Number of passes to trace at once, each of about the image's pixels."""
        if self._is_serial:
            return 1
        pixel_count = len(self._sums.counts)
        size = pixel_count * (_LIGHT_BYTES + (_AOV_BYTES if self._context.layers else 0))
        seconds = pixel_count * self.seconds_per_path
        return _passes_at_once(round(left / pixel_count), size, seconds, interval)

    def _next_pass(self) -> list[Unit]:
        """The next pass of the round, or of a new one, which a source is told of."""
        units = next(self._round, None)
        if units is not None:
            return units
        whole = self._rounds.begin()
        if self._source is not None:
            self._source.begin(whole, sum(self.tiles.size_of(unit) for unit in whole))
        self._round = self._rounds.passes(whole)
        return next(self._round)

    def _take_whole(self, number: int, progress: Progress | None) -> list[_Traced]:
        """A sample of the whole image from the source."""
        assert self._source is not None
        if number >= self._announced:
            last = self._limits.samples
            self._announced = min(last, FIRST_SAMPLES) if self._is_adaptive else last
            units = (Unit(np.array([k])) for k in range(number, self._announced))
            count = self._announced - number
            self._source.begin(units, count * len(self._sums.counts))
        return [(0, *self._source.take(progress))]

    def _take_tiles(self, progress: Progress | None) -> list[_Traced]:
        """A pass of tiles from the source."""
        assert self._source is not None
        made: list[_Traced] = []
        done = 0
        for unit in self._next_pass():
            sampled = self._source.take(part_of(progress, done, 0))
            made.append((self.tiles.pixels(unit.tiles), *sampled))
            done += self.tiles.size_of(unit)
        return made


def _figures(sums: Film) -> dict[str, Any]:
    return {"samples": _mean_samples(sums), "error": sums.error()}


def _mean_samples(sums: Film) -> int | float:
    """The mean number of samples of a pixel, an int if all are equal."""
    paths, pixel_count = int(sums.counts.sum()), len(sums.counts)
    fewest = int(sums.counts.min())
    return fewest if paths == fewest * pixel_count else paths / pixel_count


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


def _add(sums: Film, layers: Sequence[str], traced: Sequence[_Traced]) -> None:
    """Add samples to the film, with the layers of single ones."""
    for pixels, light, aovs in traced:
        sums.add_samples(pixels, light)
        for name in layers:
            sums.set_layer(name, pixels, getattr(aovs, name))
