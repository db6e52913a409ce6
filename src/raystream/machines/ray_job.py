"""RayJob: rays for a machine to trace, and where what it finds goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.collect import HitArrays
from raystream.kernels.local_frame import LocalRays

__all__ = ["HitGoal", "RayJob"]


class HitGoal(NamedTuple):
    """What is wanted of all rays of a job.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    out : HitArrays or None
        Where hits are kept; None if they are only counted.
    hands_over : bool
        Whether hits are handed over, and shading counts as a pass; not if they are only counted.
    """

    surfaces: bool
    out: HitArrays | None
    hands_over: bool


@dataclass(frozen=True)
class RayJob:
    """Rays, and the hits that each of them wants.

    Attributes
    ----------
    rays : LocalRays
    first, capacity : ndarray of shape (N,), uint64
        Row of the first hit, and how many are wanted.
    tallies : ndarray of shape (N, 8), uint32, or None
        See `kernels.tally`.
    """

    rays: LocalRays
    first: NDArray[np.uint64]
    capacity: NDArray[np.uint64]
    tallies: NDArray[np.uint32] | None

    def __len__(self) -> int:
        return len(self.first)

    def part(self, rows: Any) -> RayJob:
        """Some of the rays: a slice shares their tallies, an index does not."""
        rays = LocalRays(*(array[rows] for array in self.rays))
        tallies = None if self.tallies is None else self.tallies[rows]
        return RayJob(rays, self.first[rows], self.capacity[rows], tallies)
