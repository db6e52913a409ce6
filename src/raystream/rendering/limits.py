"""Limits: when progressive rendering stops."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from raystream.rendering.adaptive import FIRST_SAMPLES
from raystream.rendering.film import Film

__all__ = ["Limits"]


@dataclass(frozen=True)
class Limits:
    """When rendering stops: at the first limit reached.

    Attributes
    ----------
    samples : int
        Per pixel, at most.
    noise : float, optional
        Relative error of the image, see `Film.error`; tested from 8 samples on.
    seconds : float, optional
        Whole samples of the image are traced, or passes of tiles, which take about as long: at
        least one, and as many as end nearest to the limit. Time before an interruption does not
        count.
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

    def expected_paths(self, sums: Film, seconds: float, seconds_per_path: float) -> int:
        """Estimate the paths that the image will have; at most those it has once it is complete.

        Parameters
        ----------
        sums : Film
        seconds : float
            Since the start.
        seconds_per_path : float
            Of the last passes; inf before the first.
        """
        done, fewest = int(sums.counts.sum()), int(sums.counts.min())
        if fewest >= self.samples:
            return done
        most = int(np.maximum(sums.counts, self.samples).sum())
        expected = float(most)
        if self.seconds is not None and done > 0:
            left = self.seconds - seconds
            if left <= 0.0:
                return done
            if math.isfinite(seconds_per_path):
                if left < 0.5 * seconds_per_path * len(sums.counts):
                    return done
                expected = min(expected, done + left / max(seconds_per_path, 1e-12))
        if self.noise is not None and fewest >= FIRST_SAMPLES:
            error = sums.error()
            if error <= self.noise:
                return done
            ratio = error / self.noise
            expected = min(expected, done * ratio * ratio)  # 4x the samples halve the error
        return min(most, max(math.ceil(expected), done + len(sums.counts)))
