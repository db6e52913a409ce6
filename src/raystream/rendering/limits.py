"""Limits: when progressive rendering stops."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from raystream.rendering.film import Film

#: Samples of every pixel before their variance is meaningful.
FIRST_SAMPLES = 8


class Pace(NamedTuple):
    """How fast an image is rendered.

    Attributes
    ----------
    first : int
        Number of paths at the start.
    seconds : float
        Since the start.
    seconds_per_path : float
        Of a pass; inf for unknown.
    """

    first: int
    seconds: float
    seconds_per_path: float


@dataclass(frozen=True)
class Limits:
    """When rendering stops: at the first limit reached, with equal samples for all pixels.

    Attributes
    ----------
    samples : int
        Per pixel, at most.
    noise : float, optional
        Relative error of the image, see `Film.error`; tested from 8 samples on.
    seconds : float, optional
        Whole samples of the image are traced: at least one, and as many as end nearest to the
        limit. Samples of a cluster or of a multipass machine that have begun are finished. Time
        before an interruption does not count.
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

    def expected_paths(self, sums: Film, pace: Pace | None) -> int:
        """Estimate the paths that the image will have; at most those it has once it is complete.

        Parameters
        ----------
        sums : Film
        pace : Pace, optional
            None while time does not matter: only the other limits are tested.
        """
        pixel_count, taken = len(sums.counts), int(sums.counts.min())
        done, most = taken * pixel_count, self.samples * pixel_count
        if taken >= self.samples:
            return done
        expected = float(most)
        if self.seconds is not None and pace is not None and done > 0:
            left = self.seconds - pace.seconds
            is_known = math.isfinite(pace.seconds_per_path)
            if left <= (0.5 * pace.seconds_per_path * pixel_count if is_known else 0.0):
                return done
            if done > pace.first:
                mean = pace.seconds / (done - pace.first)
                rate = pace.seconds_per_path if is_known else mean
                expected = min(expected, done + left / max(rate, 1e-12))
        if self.noise is not None and taken >= FIRST_SAMPLES:
            error = sums.error()
            if error <= self.noise:
                return done
            ratio = error / self.noise
            expected = min(expected, done * ratio * ratio)  # 4x the samples halve the error
        return min(most, max(math.ceil(expected), done + pixel_count))
