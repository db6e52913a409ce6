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
        Samples that have begun are finished: one of the whole image, or as many as fit into the
        time that is left. Time before an interruption does not count.
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

    def expected_paths(self, sums: Film, first: int, seconds: float) -> int:
        """Estimate the paths that the image will have; at most those it has once it is complete.

        Parameters
        ----------
        sums : Film
        first : int
            Number of paths at the start.
        seconds : float
            Since the start.
        """
        done, fewest = int(sums.counts.sum()), int(sums.counts.min())
        if fewest >= self.samples:
            return done
        most = int(np.maximum(sums.counts, self.samples).sum())
        expected = float(most)
        if self.seconds is not None and done > 0:
            if seconds >= self.seconds:
                return done
            if done > first:
                per_second = (done - first) / max(seconds, 1e-9)
                expected = min(expected, first + per_second * self.seconds)
        if self.noise is not None and fewest >= FIRST_SAMPLES:
            error = sums.error()
            if error <= self.noise:
                return done
            ratio = error / self.noise
            expected = min(expected, done * ratio * ratio)  # 4x the samples halve the error
        return min(most, max(math.ceil(expected), done + len(sums.counts)))
