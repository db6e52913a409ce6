"""RayJob: rays to trace, and where their hits go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.hits import HitArrays
from raystream.kernels.local_frame import LocalRays


class HitGoal(NamedTuple):
    """The hits wanted of all rays of a job.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    out : HitArrays or None
        Where hits are kept; None if they are only counted.
    shaded_hits : uint64
        See `StepArguments`.
    """

    surfaces: bool
    out: HitArrays | None
    shaded_hits: np.uint64


@dataclass(frozen=True)
class RayJob:
    """Rays, and the number of hits that each of them wants.

    Attributes
    ----------
    rays : LocalRays
    first, capacity : ndarray of shape (N,), uint64
        Row of the first hit, and number of hits wanted.
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
        """Some of the rays; a slice shares their tallies, an index array copies them."""
        rays = LocalRays(*(array[rows] for array in self.rays))
        tallies = None if self.tallies is None else self.tallies[rows]
        return RayJob(rays, self.first[rows], self.capacity[rows], tallies)
