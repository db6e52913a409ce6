"""Replay recorded walks: the passes of any schedule, without tracing again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.threads import Progress, parallel_for
from raystream.machines.multipass import MultipassBackend
from raystream.machines.records import RayState
from raystream.machines.schedulers import (
    DEFAULT_THRESHOLD,
    Double,
    MostWork,
    Naive,
    Queues,
    Scheduler,
    Threshold,
)
from raystream_lab.walks.kernels.replay_passes import (
    CHOSEN,
    DOUBLE,
    END,
    MOST_WORK,
    NAIVE,
    THRESHOLD,
    QueueState,
    run_passes,
)
from raystream_lab.walks.walks import Walks

#: Maximum passes per call of the compiled loop.
_PASSES_PER_CALL = 1 << 14

_RULES: dict[type, int] = {
    Naive: NAIVE,
    Threshold: THRESHOLD,
    MostWork: MOST_WORK,
    Double: DOUBLE,
}


class ReplayedPass(NamedTuple):
    """One pass.

    Attributes
    ----------
    kernel : str
    run_count : int
        Number of rays that it ran on.
    """

    kernel: str
    run_count: int


@dataclass(frozen=True)
class Replay:
    """The passes of a schedule, in order.

    Attributes
    ----------
    names : tuple of str
        The kernels, in the order in which a ray reaches them.
    at_once : tuple of int
        Maximum steps of each per pass.
    ray_count : int
        Number of rays.
    kernels : ndarray of shape (P,), uint8
        Index into `names` of each pass's kernel.
    run_counts : ndarray of shape (P,), uint32
        Number of rays that it ran on.
    optimal_count : int
        Lower bound on the passes of any schedule; see `machines.Passes`.
    """

    names: tuple[str, ...]
    at_once: tuple[int, ...]
    ray_count: int
    kernels: NDArray[np.uint8]
    run_counts: NDArray[np.uint32]
    optimal_count: int

    def __len__(self) -> int:
        return len(self.kernels)

    def __iter__(self) -> Iterator[ReplayedPass]:
        for kernel, count in zip(self.kernels.tolist(), self.run_counts.tolist(), strict=True):
            yield ReplayedPass(self.names[kernel], count)

    @property
    def passes(self) -> dict[str, int]:
        """Passes of each kernel."""
        counts = np.bincount(self.kernels, minlength=len(self.names))
        return dict(zip(self.names, counts.tolist(), strict=True))

    @property
    def runs(self) -> dict[str, int]:
        """Number of rays that each kernel ran on, summed over its passes."""
        sums = np.zeros(len(self.names), np.int64)
        np.add.at(sums, self.kernels, self.run_counts.astype(np.int64))
        return dict(zip(self.names, sums.tolist(), strict=True))

    @property
    def efficiency(self) -> float:
        """SIMD efficiency: mean share of all rays that a pass ran on; nan without passes."""
        if not len(self):
            return float("nan")
        return float(self.run_counts.mean(dtype=np.float64) / self.ray_count)


def replay(
    walks: Walks,
    *,
    scheduler: str | Scheduler = "threshold",
    threshold: float = DEFAULT_THRESHOLD,
    traversal_steps: int = 1,
    intersections: int = 1,
) -> Replay:
    """Compute the passes of a multipass machine for these rays, all traced together.

    Parameters
    ----------
    walks : Walks
    scheduler, threshold, traversal_steps, intersections
        See `raystream.machines.MultipassBackend`. The machine's `compaction` is not replayed.

    Returns
    -------
    Replay

    Raises
    ------
    ValueError, TypeError
        If an option is out of range, or a scheduler chose a kernel that no ray waits for.

    Notes
    -----
    A ray that begins a run of n steps leaves its kernel after n passes of that kernel, or n / k if
    a pass has k steps. Rays are kept in buckets by that pass, and rays with equal walks are merged:
    time is proportional to the runs of distinct walks, and to the passes.
    """
    machine = MultipassBackend(
        walks.structure,
        scheduler=scheduler,
        threshold=threshold,
        traversal_steps=traversal_steps,
        intersections=intersections,
    )
    limits = {"steps": machine.traversal_steps, "tests": machine.intersections, "": 1}
    at_once = tuple(limits[one.limit] for one in walks.kernels)
    kernels, counts = _ReplayState(walks, at_once).run(machine.scheduler)
    return Replay(
        names=walks.names,
        at_once=at_once,
        ray_count=len(walks),
        kernels=kernels,
        run_counts=counts,
        optimal_count=sum(-(-n // k) for n, k in zip(walks.most_runs, at_once, strict=True)),
    )


def sweep(
    walks: Walks,
    thresholds: Sequence[float],
    *,
    traversal_steps: int = 1,
    intersections: int = 1,
    progress: Progress | None = None,
) -> list[Replay]:
    """Replay one schedule for each threshold, on all threads; see `replay`."""
    _ = walks.distinct, walks.most_runs  # compute once, before threads start
    replays: list[Replay | None] = [None] * len(thresholds)

    def fill(begin: int, end: int) -> None:
        for row in range(begin, end):
            replays[row] = replay(
                walks,
                threshold=thresholds[row],
                traversal_steps=traversal_steps,
                intersections=intersections,
            )

    parallel_for(fill, len(thresholds), 1, progress)
    return [one for one in replays if one is not None]


class _ReplayState:
    """The state of rays in a replayed schedule."""

    def __init__(self, walks: Walks, at_once: Sequence[int]) -> None:
        check_memory(28 * len(walks), f"queues of {len(walks):,} rays would", "replay fewer rays")
        self.walks = walks
        self.at_once = np.minimum(at_once, np.iinfo(np.uint32).max).astype(np.uint32)
        self.is_tests = np.array([one.state is RayState.INTERSECTING for one in walks.kernels])
        self.queued = _queued(walks, self.at_once)

    def run(self, scheduler: Scheduler) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
        """Kernel and number of rays of each pass."""
        rule = _RULES.get(type(scheduler), CHOSEN)
        if rule == CHOSEN:
            return self._run_custom(scheduler)
        share = scheduler.share if isinstance(scheduler, Threshold) else 0.0
        parts = [self._run(rule, share, -1, _PASSES_PER_CALL)]
        while len(parts[-1][0]) == _PASSES_PER_CALL:
            parts.append(self._run(rule, share, -1, _PASSES_PER_CALL))
        return _concatenate(parts)

    def _run_custom(self, scheduler: Scheduler) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
        """Run passes chosen by a custom scheduler."""
        kernels = self.walks.kernels
        parts = [self._run(CHOSEN, 0.0, -1, 0)]
        latest: int | None = None
        while any(waiting := self.queued.waiting.tolist()):
            latest = scheduler.choose(Queues(kernels, waiting, latest))
            if latest not in range(len(kernels)) or not waiting[latest]:
                raise ValueError(f"scheduler: {scheduler!r} chose {latest}, for which no ray waits")
            parts.append(self._run(CHOSEN, 0.0, latest, 1))
        return _concatenate(parts)

    def _run(
        self, rule: int, share: float, chosen: int, room: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
        out = np.empty(room, np.uint8), np.empty(room, np.uint32)
        count = run_passes(
            self.walks.distinct,
            self.at_once,
            self.is_tests,
            rule,
            share,
            chosen,
            self.queued,
            out,
        )
        return out[0][:count], out[1][:count]


def _concatenate(
    parts: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint32]]],
) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
    kernels, counts = zip(*parts, strict=True)
    return np.concatenate(kernels), np.concatenate(counts)


def _queued(walks: Walks, at_once: NDArray[np.uint32]) -> QueueState:
    """The initial queues: all rays wait for their first runs."""
    splits, kernel_count = walks.distinct.run_splits, len(walks.kernels)
    count = len(splits) - 1
    # No run is longer than all steps of its kernel on its ray.
    longest = [-(-n // k) for n, k in zip(walks.most_runs, at_once.tolist(), strict=True)]
    sizes = [1 << n.bit_length() for n in longest]
    links = np.arange(1, count + 1, dtype=np.uint32)
    links[-1:] = END
    return QueueState(
        waiting=np.zeros(kernel_count, np.int64),
        clocks=np.zeros(kernel_count, np.uint64),
        offsets=(np.cumsum(sizes) - sizes).astype(np.uint64),
        masks=(np.array(sizes) - 1).astype(np.uint64),
        heads=np.full(sum(sizes), END, np.uint32),
        links=links,
        cursors=splits[:-1].copy(),
        latest=np.full(1, -1, np.int64),
        leaving=np.array([0 if count else END], np.uint32),
    )
