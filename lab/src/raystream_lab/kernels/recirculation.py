"""Measure the cost of keeping rays in memory between passes, and of skipping idle rays.

Foley 2005, section 5, sees two issues that limit a streaming ray tracer: "the inefficiency of load
balancing and the costs of data recirculation". Both are measured here: the same rays take the same
steps, by the same device functions, on the multipass and on the branching machine; and a pass
spends time on rays that do not wait for it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.kernels.hits import Sink
from raystream.kernels.local_frame import LocalRays
from raystream.machines import Branching
from raystream.structures import Structure
from raystream_lab.kernels.snapshots import Search, in_local_frame
from raystream_lab.timing import repeat, seconds_of

#: Structures whose branching machine traces single rays, as `kernels.queries` does.
_ONE_BY_ONE = ("brute", "grid", "kdtree", "graph")

#: Timed passes in which no ray waits for the kernel.
_IDLE_RUNS = 20


class PassTime(NamedTuple):
    """One pass.

    Attributes
    ----------
    kernel : str
    run_count : int
        Number of rays that it ran on.
    record_count : int
        Number of rays whose state it checked.
    seconds : float
    """

    kernel: str
    run_count: int
    record_count: int
    seconds: float


@dataclass(frozen=True)
class Recirculation:
    """The same search on both machines.

    Attributes
    ----------
    passes : list of PassTime
        Without those that return hits before compaction.
    idle_seconds : dict of str to float
        By kernel: the time of a pass per ray that it checks and does not run on, measured on
        streams in which no ray waits. Without the first kernel, which runs on all rays.
    branching_seconds : float
        Median of three runs of the same search on the branching machine.
    """

    passes: list[PassTime]
    idle_seconds: Mapping[str, float]
    branching_seconds: float

    @property
    def step_count(self) -> int:
        """Kernel runs on rays, including set-up and shading: the same on both machines."""
        return sum(one.run_count for one in self.passes)

    @property
    def multipass_seconds(self) -> float:
        """Sum over all passes, without the time between them."""
        return sum(one.seconds for one in self.passes)

    @property
    def seconds_per_step(self) -> float:
        """Seconds per step on the multipass machine, passes only."""
        return self.multipass_seconds / self.step_count

    @property
    def branching_seconds_per_step(self) -> float:
        """Seconds per step on the branching machine."""
        return self.branching_seconds / self.step_count

    @property
    def idle_share(self) -> float:
        """Share of the passes' time spent on idle rays, at `idle_seconds` each."""
        lost = [
            (one.record_count - one.run_count) * self.idle_seconds.get(one.kernel, 0.0)
            for one in self.passes
        ]
        return sum(lost) / self.multipass_seconds

    @property
    def sparse_share(self) -> float:
        """Share of the passes' time that full ones would save.

        The excess over the same runs at the rate of the kernel's fullest passes (those at least
        half as full as the fullest): due to idle rays, and because the others are scattered in
        memory. May be below 0 where full passes are no faster.
        """
        return 1.0 - sum(map(_full_seconds, self._by_kernel())) / self.multipass_seconds

    def _by_kernel(self) -> list[list[PassTime]]:
        names = dict.fromkeys(one.kernel for one in self.passes)
        return [[one for one in self.passes if one.kernel == name] for name in names]

    @property
    def efficiency(self) -> float:
        """Mean share of rays that a pass ran on (Purcell 2002, Table 2)."""
        return float(np.mean([one.run_count / one.record_count for one in self.passes]))


class OccupancyBin(NamedTuple):
    """Passes in which a similar share of rays took part.

    Attributes
    ----------
    low : float
        Smallest share.
    run_count : int
    seconds : float
    """

    low: float
    run_count: int
    seconds: float


def measure_recirculation(
    structure: Structure,
    rays: LocalRays,
    *,
    scheduler: str = "threshold",
    compaction: bool = False,
) -> Recirculation:
    """Time each pass of a first-hit search, and the same search on the branching machine.

    Parameters
    ----------
    structure : Structure
        Not a BVH: its branching machine traces many rays at once, with other functions.
    rays : LocalRays
        From `snapshots.local_rays`.
    scheduler : str
    compaction : bool
        Whether to drop finished rays from the streams.

    Raises
    ------
    ValueError
        If the structure is a BVH.
    """
    if structure.name not in _ONE_BY_ONE:
        known = ", ".join(_ONE_BY_ONE)
        raise ValueError(
            f"structure: {structure.name!r} traces many rays at once on the branching machine, "
            f"with other functions than on the multipass machine; expected one of {known}"
        )
    few = LocalRays(*(column[:1] for column in rays))
    Search(structure, few, scheduler).run()  # compiles
    search = Search(structure, rays, scheduler, compaction)
    launch = _time_idle(Search(structure, few, scheduler))
    whole = _time_idle(search)
    extra = max(1, len(rays.t_min) - 1)
    idle = {name: max(0.0, whole[name] - launch[name]) / extra for name in whole}
    passes: list[PassTime] = []
    for kernel, waiting in search.schedule():
        count, name = len(search.streams), search.steps.kernels[kernel].name
        seconds = seconds_of(partial(search.streams.run, kernel, None))
        passes.append(PassTime(name, waiting[kernel], count, seconds))
    return Recirculation(passes, idle, _time_branching(structure, rays))


def by_occupancy(
    passes: Sequence[PassTime], edges: Sequence[float] = (0.0, 0.01, 0.1, 0.25, 0.5, 0.75, 1.0)
) -> list[OccupancyBin]:
    """Bin passes by the share of rays that they ran on.

    Parameters
    ----------
    passes : sequence of PassTime
    edges : sequence of float
        Bin edges, increasing, from 0 to 1.
    """
    shares = np.array([one.run_count / one.record_count for one in passes])
    bins = np.clip(np.searchsorted(edges, shares, side="right") - 1, 0, len(edges) - 2)
    result = []
    for k in range(len(edges) - 1):
        own = [one for one, number in zip(passes, bins.tolist(), strict=True) if number == k]
        runs = sum(one.run_count for one in own)
        seconds = sum(one.seconds for one in own)
        result.append(OccupancyBin(edges[k], runs, seconds))
    return result


def _full_seconds(passes: list[PassTime]) -> float:
    """Time of all runs of a kernel at the rate of its fullest passes."""
    shares = [one.run_count / one.record_count for one in passes]
    full = [p for p, share in zip(passes, shares, strict=True) if 2 * share >= max(shares)]
    rate = sum(one.seconds for one in full) / sum(one.run_count for one in full)
    return rate * sum(one.run_count for one in passes)


def _time_idle(search: Search) -> dict[str, float]:
    """Seconds per pass of each kernel but the first, on rays that all wait for the first."""
    result = {}
    for kernel, one in enumerate(search.steps.kernels[1:], 1):
        seconds = repeat(partial(search.streams.run, kernel, None), _IDLE_RUNS)
        result[one.name] = float(np.median(seconds))
    return result


def _time_branching(structure: Structure, rays: LocalRays) -> float:
    backend, query = Branching(in_local_frame(structure)), Query(Kind.FIRST_HIT)
    batch = RayBatch(*rays)
    sink = Sink.of(query, len(batch))
    one = RayBatch(*(column[:1] for column in rays))
    backend.run(query, one, Sink.of(query, 1))
    return float(np.median(repeat(lambda: backend.run(query, batch, sink), 3)))
