"""Adaptive resolution while the camera moves, and time slicing of the rendering."""

from __future__ import annotations

import math
from collections import deque

#: Image size relative to the canvas, per side.
SCALES = (1.0, 0.8, 0.64, 0.5, 0.4, 0.32, 0.25, 0.2, 0.16, 0.125)

#: Minimum side of an image, in pixels.
_MIN_SIDE = 16

#: Hysteresis: the resolution drops when a frame takes this much longer than its target, and rises
#: when the next size is expected to take this much less. One step of `SCALES` changes the number
#: of pixels by a factor of about 1.6 only, so that a resolution stays stable once found.
_DECREASE_ABOVE, _INCREASE_BELOW = 1.15, 0.85

#: Weight of a new measurement in the moving average.
_NEW_WEIGHT = 0.3

#: A measurement off by this factor means that the scene has changed, and replaces the average.
_RESET_FACTOR = 2.0

#: Seconds between updates while the camera rests: the minimum, the share of the time elapsed, and
#: the maximum.
_MIN_PAUSE, _PAUSE_SHARE, _MAX_PAUSE = 0.1, 0.15, 2.0


class Cost:
    """Cost of a pixel, as a moving average of measurements.

    Attributes
    ----------
    seconds : float
        Per pixel; nan before the first measurement.
    """

    def __init__(self) -> None:
        self.seconds = math.nan

    @property
    def is_known(self) -> bool:
        """Whether anything has been measured."""
        return not math.isnan(self.seconds)

    def record(self, pixels: int, seconds: float) -> None:
        """Record a measurement."""
        measured = max(seconds, 1e-9) / max(pixels, 1)
        ratio = measured / self.seconds
        if not 1.0 / _RESET_FACTOR < ratio < _RESET_FACTOR:  # true for nan, too
            self.seconds = measured
        else:
            self.seconds += _NEW_WEIGHT * (measured - self.seconds)

    def expected(self, pixels: int) -> float:
        """Estimate the seconds for a number of pixels; nan if unknown."""
        return self.seconds * pixels


class FrameRate:
    """Frames per second over the last second."""

    def __init__(self) -> None:
        self._moments: deque[float] = deque(maxlen=256)

    def record(self, now: float) -> None:
        """Record a frame."""
        self._moments.append(now)

    def now(self, now: float) -> float:
        """Return the current frame rate; 0 without frames in the last second."""
        recent = [moment for moment in self._moments if now - moment <= 1.0]
        if len(recent) < 2:
            return 0.0
        return round((len(recent) - 1) / max(recent[-1] - recent[0], 1e-9), 2)


class AdaptiveResolution:
    """Chooses the image size that reaches the target frame rate while the camera moves.

    The size drops as far as necessary as soon as frames take too long, and rises by one step
    at a time when the larger size is expected to be fast enough.

    Parameters
    ----------
    target : float
        Target seconds per frame.
    """

    def __init__(self, target: float = 0.05) -> None:
        self._target = target
        self._cost = Cost()
        self._step = 0

    @property
    def scale(self) -> float:
        """Image size relative to the canvas, per side."""
        return SCALES[self._step]

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return the size of the next image for a canvas."""
        return scaled_size(width, height, self.scale)

    def record(self, width: int, height: int, pixels: int, seconds: float) -> None:
        """Record the duration of a frame.

        Parameters
        ----------
        width, height : int
            Size of the canvas.
        pixels : int
            Number of pixels of the frame.
        seconds : float
            Time since the previous frame.
        """
        self._cost.record(pixels, seconds)
        self._choose_step(width, height)

    def apply_cost(self, width: int, height: int, cost: Cost) -> None:
        """Apply a lower bound for the frame time: the rendering cost of the pixels.

        Keeps the first frames, and frames that get cancelled, from being too large.

        Parameters
        ----------
        width, height : int
            Size of the canvas.
        cost : Cost
        """
        if cost.seconds > self._cost.seconds or math.isnan(self._cost.seconds):
            self._cost.seconds = cost.seconds
            self._choose_step(width, height)

    def _choose_step(self, width: int, height: int) -> None:
        """Choose the size from the current estimates."""
        expected = self._expected(self._step, width, height)
        if expected > _DECREASE_ABOVE * self._target:
            while self._step < len(SCALES) - 1 and not (
                self._expected(self._step, width, height) <= self._target
            ):
                self._step += 1
        elif self._step > 0 and (
            self._expected(self._step - 1, width, height) < _INCREASE_BELOW * self._target
        ):
            self._step -= 1

    def _expected(self, step: int, width: int, height: int) -> float:
        columns, rows = scaled_size(width, height, SCALES[step])
        return self._cost.expected(columns * rows)


def scaled_size(width: int, height: int, scale: float) -> tuple[int, int]:
    """Scale a size, approximately preserving its aspect ratio."""
    least = min(_MIN_SIDE, width), min(_MIN_SIDE, height)
    return max(round(width * scale), least[0]), max(round(height * scale), least[1])


def update_interval(seconds: float) -> float:
    """Return the seconds between updates after accumulating samples for some seconds."""
    return min(max(_MIN_PAUSE, _PAUSE_SHARE * seconds), _MAX_PAUSE)


def slice_rows(rows_left: int, row_seconds: float, seconds: float) -> int:
    """Choose the rows of a slice, so that all slices take about equally long.

    Parameters
    ----------
    rows_left : int
        Remaining rows of the image.
    row_seconds : float
        Expected seconds per row; nan if unknown, which gives one row.
    seconds : float
        Time limit of the slice.
    """
    if math.isnan(row_seconds):
        return 1
    slices = max(1, round(rows_left * row_seconds / seconds))
    return min(rows_left, max(1, -(-rows_left // slices)))
