"""Progressive images: rendered by sample and by row, in time slices."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress
from raystream.rendering.contexts import with_bands
from raystream.rendering.film import Film
from raystream.rendering.integrator import Integrator, RenderContext
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler
from raystream.viewer.adaptive_resolution import Cost, slice_rows
from raystream.viewer.messages import Message
from raystream.viewer.settings import DisplaySettings

#: A slice that exceeds its time limit by this factor is aborted, and retried with fewer rows.
_ABORT_FACTOR = 6.0


class WorkCancelledError(Exception):
    """Raised to end work that has been cancelled."""


class _SliceTimeoutError(Exception):
    """Raised to end a slice that takes much longer than expected."""


class _SliceTimer:
    """Watches a slice, as its progress callback."""

    def __init__(self, is_wanted: Callable[[], bool], most: float) -> None:
        self._is_wanted, self._most = is_wanted, most
        self._started = time.perf_counter()
        self.reached = 0.0

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return time.perf_counter() - self._started

    def __call__(self, done: int, total: int) -> None:
        self.reached = done / max(total, 1)
        if not self._is_wanted():
            raise WorkCancelledError
        if done < total and self.seconds > self._most:
            raise _SliceTimeoutError


class Drawing(NamedTuple):
    """An image ready for display.

    Attributes
    ----------
    pixels : ndarray of shape (H, W, 3), float32
        Linear RGB.
    display : DisplaySettings
        How to encode it.
    """

    pixels: NDArray[np.float32]
    display: DisplaySettings


class ProgressiveImage(ABC):
    """An image rendered row by row, once per sample.

    Parameters
    ----------
    size : (int, int)
        Image width and height.
    target : int
        Number of samples.
    cost : Cost
        Cost estimate of such images, updated by this one.
    most_rows : int, optional
        Maximum rows per slice.

    Attributes
    ----------
    samples : int
        Completed samples.
    seconds : float
        Seconds spent on the latest sample so far.
    """

    def __init__(
        self, size: tuple[int, int], target: int, cost: Cost, most_rows: int = 1 << 30
    ) -> None:
        self.width, self.height = size
        self._most_rows = most_rows
        self.target = target
        self.samples = 0
        self.seconds = 0.0
        self._cost = cost
        self._row = 0

    @property
    def is_done(self) -> bool:
        """Whether all samples are complete."""
        return self.samples >= self.target

    @property
    def seconds_left(self) -> float:
        """Expected seconds for the rest of the sample; nan if unknown."""
        return self._cost.expected(self.width * (self.height - self._row))

    def advance(self, seconds: float, is_wanted: Callable[[], bool]) -> bool:
        """Render one slice.

        Parameters
        ----------
        seconds : float
            Time limit.
        is_wanted : callable
            Polled during the slice, which ends when it returns False.

        Returns
        -------
        bool
            Whether a sample has just been completed.

        Raises
        ------
        WorkCancelledError
            If `is_wanted` returned False.
        """
        left = self.height - self._row
        count = slice_rows(left, self._cost.expected(self.width), seconds)
        count = min(count, self._most_rows)
        if self._row == 0:
            self.seconds = 0.0
        watch = _SliceTimer(is_wanted, _ABORT_FACTOR * seconds if count > 1 else math.inf)
        rows = range(self._row, self._row + count)
        try:
            self._trace(rows, self.samples, watch)
        except _SliceTimeoutError:
            # Extrapolate the cost from the part that was done.
            self._cost.record(max(int(self.width * count * watch.reached), 1), watch.seconds)
            self.seconds += watch.seconds
            return False
        self.seconds += watch.seconds
        self._cost.record(self.width * count, watch.seconds)
        self._row = rows.stop
        if self._row < self.height:
            return False
        self._row = 0
        self.samples += 1
        return True

    @abstractmethod
    def _trace(self, rows: range, sample: int, progress: Progress) -> None:
        """Trace one sample of some rows."""

    @abstractmethod
    def draw(self, display: DisplaySettings) -> Callable[[], Drawing]:
        """Return a function that draws the current state; it may run on any thread."""

    def draw_whole(self, display: DisplaySettings) -> Callable[[], Drawing]:
        """Like `draw`, for a file of its own, with a legend if there is one."""
        return self.draw(display)

    def facts(self, display: DisplaySettings) -> Message:
        """Return additional header fields."""
        del display
        return {"counters": None}

    def noise(self) -> float | None:
        """Estimate the relative error, if possible; takes some time."""
        return None


class SampledImage(ProgressiveImage):
    """A progressive image of a rendering mode.

    Parameters
    ----------
    renderer : Integrator
    context : RenderContext
        Its sampler determines the number of samples.
    cost : Cost
    """

    def __init__(self, renderer: Integrator, context: RenderContext, cost: Cost) -> None:
        super().__init__((context.width, context.height), context.sampler.sample_count, cost)
        self._renderer, self._context = renderer, context
        self._light: NDArray[np.float32] | None = None
        self._sums: Film | None = None
        if self.target == 1:
            self._light = np.zeros((self.width * self.height, 3), np.float32)
        else:
            self._sums = Film(self.width, self.height)

    def _trace(self, rows: range, sample: int, progress: Progress) -> None:
        light, _ = trace_sample(self._renderer, self._context, sample, progress, rows)
        first = rows.start * self.width
        if self._sums is not None:
            self._sums.add_samples(first, light)
        elif self._light is not None:
            self._light[first : first + len(light)] = light

    def draw(self, display: DisplaySettings) -> Callable[[], Drawing]:
        """See `ProgressiveImage.draw`."""
        if self._sums is not None:
            pixels = self._sums.mean()
        else:
            assert self._light is not None
            pixels = self._light.reshape(self.height, self.width, 3)
        return lambda: Drawing(pixels, display)

    def noise(self) -> float | None:
        """See `ProgressiveImage.noise`."""
        if self._sums is None or self.samples < 2:
            return None
        error = self._sums.error()
        return error if math.isfinite(error) else None


def centered(context: RenderContext) -> RenderContext:
    """Return the same view with one sample, through the pixel centres."""
    return _with(context, sampler=Sampler.of("sobol", context.sampler.seed, 1))


def with_samples(context: RenderContext, samples: int) -> RenderContext:
    """Return the same view with this many samples per pixel, as taken by `raystream.render`."""
    return _with(context, sampler=Sampler.of("sobol", context.sampler.seed, samples))


def _with(context: RenderContext, **changes: Any) -> RenderContext:
    """Return a changed context, also on the device."""
    made = replace(context, **changes)
    return with_bands(made)
