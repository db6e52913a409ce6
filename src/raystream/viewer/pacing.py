"""Pacing: how large a picture may be while the camera moves, and how long a slice of work is."""

from __future__ import annotations

import math
from collections import deque

__all__ = ["SCALES", "Cost", "FrameRate", "Resolution", "pause_after", "rows_of_slice"]

#: Parts of the canvas's width and height that pictures have, from all of it down to an eighth.
SCALES = (1.0, 0.8, 0.64, 0.5, 0.4, 0.32, 0.25, 0.2, 0.16, 0.125)

#: Fewer pixels than this along a side show nothing.
_LEAST_SIDE = 16

#: A frame may take so much more than it should before pictures become smaller, and must be
#: expected to take so much less before they become larger. With the gap between them a
#: resolution, once found, is kept: one step of `SCALES` changes the pixels by about 1.6 only.
_TOO_LONG, _SHORT_ENOUGH = 1.15, 0.85

#: How much of a new measurement goes into what is expected.
_NEW = 0.3

#: A measurement that is so many times off says that the scene has changed: it is believed.
_OTHER = 2.0

#: Pauses between two pictures of a camera that rests: at first, in proportion to the time that
#: has gone by, and at last.
_FIRST_PAUSE, _PAUSE_SHARE, _LAST_PAUSE = 0.1, 0.15, 2.0


class Cost:
    """What a pixel costs, learned from what pixels did.

    Attributes
    ----------
    seconds : float
        For a pixel; nan before anything is known.
    """

    def __init__(self) -> None:
        self.seconds = math.nan

    @property
    def is_known(self) -> bool:
        """Whether there is a number."""
        return not math.isnan(self.seconds)

    def note(self, pixels: int, seconds: float) -> None:
        """Take in that so many pixels took so long."""
        measured = max(seconds, 1e-9) / max(pixels, 1)
        ratio = measured / self.seconds
        if not 1.0 / _OTHER < ratio < _OTHER:  # also for nan
            self.seconds = measured
        else:
            self.seconds += _NEW * (measured - self.seconds)

    def expected(self, pixels: int) -> float:
        """Seconds that so many pixels will take; nan if that is not known."""
        return self.seconds * pixels


class FrameRate:
    """Pictures in a second, over the last one."""

    def __init__(self) -> None:
        self._moments: deque[float] = deque(maxlen=256)

    def note(self, now: float) -> None:
        """Take in that there is one more."""
        self._moments.append(now)

    def now(self, now: float) -> float:
        """How many there are in a second; 0 where there were none in the last one."""
        recent = [moment for moment in self._moments if now - moment <= 1.0]
        if len(recent) < 2:
            return 0.0
        return round((len(recent) - 1) / max(recent[-1] - recent[0], 1e-9), 2)


class Resolution:
    """Chooses the size of pictures, so that they come at a wanted rate while the camera moves.

    It is lowered as soon as frames take longer than they should, in one go as far as is needed,
    and raised a step at a time where the next one is expected to be quick enough, too.

    Parameters
    ----------
    target : float
        Seconds for a frame.
    """

    def __init__(self, target: float = 0.05) -> None:
        self._target = target
        self._cost = Cost()
        self._step = 0

    @property
    def scale(self) -> float:
        """Part of the canvas's width, and of its height."""
        return SCALES[self._step]

    def size(self, width: int, height: int) -> tuple[int, int]:
        """The size of the next picture for a canvas of so many pixels."""
        return scaled_size(width, height, self.scale)

    def note(self, width: int, height: int, pixels: int, seconds: float) -> None:
        """Take in how long a frame took.

        Parameters
        ----------
        width, height : int
            Of the canvas.
        pixels : int
            Of the frame.
        seconds : float
            From one frame to the next.
        """
        self._cost.note(pixels, seconds)
        self._settle(width, height)

    def heed(self, width: int, height: int, cost: Cost) -> None:
        """Take in what pixels cost to render: a frame takes at least as long as that.

        So that even the first frames, and those that are broken off, are not too large.

        Parameters
        ----------
        width, height : int
            Of the canvas.
        cost : Cost
        """
        if cost.seconds > self._cost.seconds or math.isnan(self._cost.seconds):
            self._cost.seconds = cost.seconds
            self._settle(width, height)

    def _settle(self, width: int, height: int) -> None:
        """Choose the size for a canvas by what is known."""
        expected = self._expected(self._step, width, height)
        if expected > _TOO_LONG * self._target:
            while self._step < len(SCALES) - 1 and not (
                self._expected(self._step, width, height) <= self._target
            ):
                self._step += 1
        elif self._step > 0 and (
            self._expected(self._step - 1, width, height) < _SHORT_ENOUGH * self._target
        ):
            self._step -= 1

    def _expected(self, step: int, width: int, height: int) -> float:
        columns, rows = scaled_size(width, height, SCALES[step])
        return self._cost.expected(columns * rows)


def scaled_size(width: int, height: int, scale: float) -> tuple[int, int]:
    """Width and height of a smaller picture of about the same shape."""
    least = min(_LEAST_SIDE, width), min(_LEAST_SIDE, height)
    return max(round(width * scale), least[0]), max(round(height * scale), least[1])


def pause_after(seconds: float) -> float:
    """Seconds between two pictures while samples are gathered, after so many of gathering."""
    return min(max(_FIRST_PAUSE, _PAUSE_SHARE * seconds), _LAST_PAUSE)


def rows_of_slice(rows_left: int, row_seconds: float, seconds: float) -> int:
    """Rows to do now, so that slices take about as long as they may, and end together.

    Parameters
    ----------
    rows_left : int
        Of the picture.
    row_seconds : float
        What a row is expected to take; nan if that is not known: then it is tried with one.
    seconds : float
        What a slice may take.
    """
    if math.isnan(row_seconds):
        return 1
    slices = max(1, round(rows_left * row_seconds / seconds))
    return min(rows_left, max(1, -(-rows_left // slices)))
