"""Pictures in the making: rows of samples, as many at a time as there is time for."""

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
from raystream.rendering.accumulation import Accumulation
from raystream.rendering.progressive import trace_sample
from raystream.rendering.sampled import SampledRenderer, Setting
from raystream.rendering.sampling.sampler import Sampler
from raystream.viewer.messages import Message
from raystream.viewer.pacing import Cost, rows_of_slice
from raystream.viewer.settings import Look

__all__ = ["BrokenOffError", "Drawing", "Picture", "SampledPicture", "centered", "spread"]

#: A slice that takes so many times what it may is given up, and tried with fewer rows.
_GIVE_UP = 6.0


class BrokenOffError(Exception):
    """Ends work that nobody waits for any more."""


class _TooLongError(Exception):
    """Ends a slice that takes much longer than was expected."""


class _Watch:
    """Watches over a slice, as the callback for its progress."""

    def __init__(self, is_wanted: Callable[[], bool], most: float) -> None:
        self._is_wanted, self._most = is_wanted, most
        self._started = time.perf_counter()
        self.reached = 0.0

    @property
    def seconds(self) -> float:
        """Since it began."""
        return time.perf_counter() - self._started

    def __call__(self, done: int, total: int) -> None:
        self.reached = done / max(total, 1)
        if not self._is_wanted():
            raise BrokenOffError
        if done < total and self.seconds > self._most:
            raise _TooLongError


class Drawing(NamedTuple):
    """A picture as it is shown.

    Attributes
    ----------
    pixels : ndarray of shape (H, W, 3), float32
        Linear RGB.
    look : Look
        How it is encoded.
    """

    pixels: NDArray[np.float32]
    look: Look


class Picture(ABC):
    """A picture that is made row by row, once for each of its samples.

    Parameters
    ----------
    size : (int, int)
        Width and height.
    target : int
        Samples.
    cost : Cost
        What is known of such pictures; it learns from this one.
    most_rows : int, optional
        That fit into a slice.

    Attributes
    ----------
    samples : int
        Those that are whole.
    seconds : float
        That the latest sample took, or took so far.
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
        """Whether it has all its samples."""
        return self.samples >= self.target

    @property
    def seconds_left(self) -> float:
        """What the rest of the sample is expected to take; nan if that is not known."""
        return self._cost.expected(self.width * (self.height - self._row))

    @property
    def seconds_of_row(self) -> float:
        """What a row is expected to take; nan if that is not known."""
        return self._cost.expected(self.width)

    def advance(self, seconds: float, is_wanted: Callable[[], bool]) -> bool:
        """Do a slice of work.

        Parameters
        ----------
        seconds : float
            What it may take.
        is_wanted : callable
            Asked now and then; where it says no, the slice ends.

        Returns
        -------
        bool
            Whether a sample is whole now.

        Raises
        ------
        BrokenOffError
            If it is not wanted any more.
        """
        left = self.height - self._row
        count = rows_of_slice(left, self._cost.expected(self.width), seconds)
        count = min(count, self._most_rows)
        if self._row == 0:
            self.seconds = 0.0
        watch = _Watch(is_wanted, _GIVE_UP * seconds if count > 1 else math.inf)
        rows = range(self._row, self._row + count)
        try:
            self._trace(rows, self.samples, watch)
        except _TooLongError:
            # What was done says how long the rest would have taken, as far as it can be told.
            self._cost.note(max(int(self.width * count * watch.reached), 1), watch.seconds)
            self.seconds += watch.seconds
            return False
        self.seconds += watch.seconds
        self._cost.note(self.width * count, watch.seconds)
        self._row = rows.stop
        if self._row < self.height:
            return False
        self._row = 0
        self.samples += 1
        return True

    @abstractmethod
    def _trace(self, rows: range, sample: int, progress: Progress) -> None:
        """Take one sample of some rows."""

    @abstractmethod
    def draw(self, look: Look) -> Callable[[], Drawing]:
        """What it shows so far; to be asked on any thread, while more samples are taken."""

    def draw_whole(self, look: Look) -> Callable[[], Drawing]:
        """The same for a file of its own, where nothing is beside it to explain it."""
        return self.draw(look)

    def facts(self, look: Look) -> Message:
        """What is known of it besides."""
        del look
        return {"counters": None}

    def noise(self) -> float | None:
        """Its relative error, if that is known; it takes a while to find."""
        return None


class SampledPicture(Picture):
    """A picture of a mode.

    Parameters
    ----------
    renderer : SampledRenderer
    setting : Setting
        Its sampler decides how many samples there are.
    cost : Cost
    """

    def __init__(self, renderer: SampledRenderer, setting: Setting, cost: Cost) -> None:
        super().__init__((setting.width, setting.height), setting.sampler.sample_count, cost)
        self._renderer, self._setting = renderer, setting
        self._light: NDArray[np.float32] | None = None
        self._sums: Accumulation | None = None
        if self.target == 1:
            self._light = np.zeros((self.width * self.height, 3), np.float32)
        else:
            self._sums = Accumulation(self.width, self.height)

    def _trace(self, rows: range, sample: int, progress: Progress) -> None:
        light, _ = trace_sample(self._renderer, self._setting, sample, progress, rows)
        first = rows.start * self.width
        if self._sums is not None:
            self._sums.add_samples(first, light)
        elif self._light is not None:
            self._light[first : first + len(light)] = light

    def draw(self, look: Look) -> Callable[[], Drawing]:
        """See `Picture.draw`."""
        if self._sums is not None:
            pixels = self._sums.mean()
        else:
            assert self._light is not None
            pixels = self._light.reshape(self.height, self.width, 3)
        return lambda: Drawing(pixels, look)

    def noise(self) -> float | None:
        """See `Picture.noise`."""
        if self._sums is None or self.samples < 2:
            return None
        error = self._sums.error()
        return error if math.isfinite(error) else None


def centered(setting: Setting) -> Setting:
    """The same view by one sample, through the pixels' centres."""
    return _with(setting, sampler=Sampler.of("sobol", setting.sampler.seed, 1))


def spread(setting: Setting, samples: int) -> Setting:
    """The same view by so many samples of each pixel, as `raystream.render` takes them."""
    return _with(setting, sampler=Sampler.of("sobol", setting.sampler.seed, samples))


def _with(setting: Setting, **changes: Any) -> Setting:
    """A changed setting, on the device, too."""
    made = replace(setting, **changes)
    return replace(made, bands=made.tracer.bands_on_device(made))
