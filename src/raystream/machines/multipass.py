"""The multipass machine: in each pass one kernel, over all rays that wait for it."""

from __future__ import annotations

import copy
import operator
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.threads import Progress, part_of
from raystream.kernels.collect import HitAddresses, HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays
from raystream.kernels.tally import new_tallies
from raystream.machines.observing import Observer, Shown
from raystream.machines.passes import Passes
from raystream.machines.ray_streams import RayStreams
from raystream.machines.records import Query
from raystream.machines.schedulers import USUAL_THRESHOLD, Scheduler, make_scheduler
from raystream.machines.steps import Steps, steps_of
from raystream.machines.steps.base import StepKernel
from raystream.machines.task import Task, Wish
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries

__all__ = ["Multipass"]

#: Memory for the rays of a query; more rays are traced in parts.
MAX_BYTES = 1 << 29

#: Bytes of a ray besides its place and its stack, with counters.
_RAY_BYTES = 160


class Multipass(BatchQueries):
    """Runs each step of a traversal as a kernel over all rays that wait for it.

    As on hardware without branching (Purcell 2002, section 2.2; Foley 2005, section 3.4): what
    a ray needs is kept in streams between passes, a state says for which kernel it waits, and
    a scheduler chooses the kernel of the next pass, until no ray is active.

    Parameters
    ----------
    structure : Structure
    scheduler : {"threshold", "naive", "most-work", "double"} or Scheduler
        How the next kernel is chosen; see `schedulers`.
    threshold : float
        For ``"threshold"``: the share of the active rays, 0 to 1, that has to wait for an
        intersection.
    traversal_steps, intersections : int
        Steps from cell to cell or node to node, and triangles tested (in trees: blocks of up
        to four), that a ray does in one pass.
    compaction : bool
        Shade the rays whose search has ended, and drop them from the streams, whenever they are
        half of them. Otherwise they stay, and every pass looks at their state.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range, or the structure has no kernels.
    """

    def __init__(
        self,
        structure: Structure,
        *,
        scheduler: str | Scheduler = "threshold",
        threshold: float = USUAL_THRESHOLD,
        traversal_steps: int = 1,
        intersections: int = 1,
        compaction: bool = False,
    ) -> None:
        self.structure = structure
        self.scheduler = make_scheduler(scheduler, threshold)
        self.traversal_steps = _at_least_one("traversal_steps", traversal_steps)
        self.intersections = _at_least_one("intersections", intersections)
        self.compaction = bool(compaction)
        self.passes: Passes | None = None
        self.observer: Observer | None = None
        steps_of(structure)  # raises for a structure that has none

    def recording(self, passes: Passes) -> Multipass:
        """The same machine, which adds its passes to a record."""
        machine = copy.copy(self)
        machine.passes = passes
        return machine

    def shown_to(self, observer: Observer) -> Multipass:
        """The same machine, which shows its rays before the first pass and after each one.

        Parameters
        ----------
        observer : callable
            Gets a `Shown`. Rays that are traced in parts, for want of memory or because they
            need more of it, begin anew with each part.
        """
        machine = copy.copy(self)
        machine.observer = observer
        return machine

    @property
    def frame(self) -> SceneFrame:
        """The frame of the structure's triangles."""
        return self.structure.frame

    def first_hit(
        self,
        rays: LocalRays,
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Find the nearest hit of each ray; see `Structure.first_hit`."""
        out.t.fill(np.inf)
        out.u.fill(0.0)
        out.v.fill(0.0)
        out.prim_id.fill(-1)
        count = len(rays.t_min)
        rows = np.arange(count, dtype=np.uint64)
        task = Task(rays, rows, np.ones(count, np.uint64), tallies)
        wish = Wish(surfaces=False, out=out, hands_over=True)
        self._trace(steps_of(self.structure), task, wish, progress)

    def any_hit(
        self,
        rays: LocalRays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way."""
        one = np.ones(len(rays.t_min), np.uint64)
        task = Task(rays, one, one, tallies)
        wish = Wish(surfaces=False, out=None, hands_over=True)
        return self._trace(steps_of(self.structure), task, wish, progress) != 0

    def count_hits(
        self,
        rays: LocalRays,
        surfaces: bool,
        limit: int = UNLIMITED,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`."""
        limits = np.full(len(rays.t_min), limit, np.uint64)
        task = Task(rays, limits, limits, tallies)
        wish = Wish(surfaces, out=None, hands_over=False)
        return self._trace(steps_of(self.structure), task, wish, progress).astype(np.int64)

    def multi_hit(
        self,
        rays: LocalRays,
        surfaces: bool,
        splits: NDArray[np.int64],
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Write the nearest hits of each ray; see `Structure.multi_hit`."""
        first, capacity = splits[:-1].astype(np.uint64), np.diff(splits).astype(np.uint64)
        wants_some = np.flatnonzero(capacity)
        task = Task(rays, first, capacity, tallies).part(wants_some)
        wish = Wish(surfaces, out, hands_over=True)
        self._trace(steps_of(self.structure), task, wish, progress)
        if tallies is not None and task.tallies is not None:
            tallies[wants_some] = task.tallies

    def _trace(
        self, steps: Steps, task: Task, wish: Wish, progress: Progress | None
    ) -> NDArray[np.uint32]:
        """Trace rays, in parts if they are many; returns how many hits each has."""
        counts = np.zeros(len(task), np.uint32)
        for rows in _parts(len(task), steps):
            report = part_of(progress, rows.start, len(task))
            counts[rows] = self._trace_part(steps, task.part(rows), wish, report)
        return counts

    def _trace_part(
        self, steps: Steps, task: Task, wish: Wish, progress: Progress | None
    ) -> NDArray[np.uint32]:
        """Trace rays for which there is memory."""
        before = task.tallies if steps.grow is None else copy.copy(task.tallies)
        runs = None if task.tallies is None else new_tallies(len(task))
        stacks = np.empty((len(task), steps.stack_bytes), np.uint8)
        query = Query(
            np.float32(self.structure.triangles.extreme),
            wish.surfaces,
            wish.out is not None,
            wish.hands_over,
            _hit_addresses(wish.out),
            _address(task.tallies),
            _address(runs),
            _address(stacks),
            np.uint64(steps.stack_bytes),
            np.uint64(self.traversal_steps),
            np.uint64(self.intersections),
        )
        streams = RayStreams(steps, query, task)
        if self.observer is not None:
            streams.on_run = self._shower(self.observer, streams, stacks, wish, task)
            streams.on_run(None)
        self._run(streams, progress)
        if self.passes is not None and runs is not None:
            at_once = {"steps": self.traversal_steps, "tests": self.intersections, "": 1}
            self.passes.add_bound(steps.kernels, runs, at_once)
        overflown = streams.finish()
        if overflown.any() and steps.grow is not None:
            # Their tallies are to be those of the search that succeeds.
            if task.tallies is not None and before is not None:
                task.tallies[overflown] = before[overflown]
            again = task.part(overflown)
            streams.counts[overflown] = self._trace(steps.grow(), again, wish, None)
            if task.tallies is not None and again.tallies is not None:
                task.tallies[overflown] = again.tallies
        return streams.counts

    @staticmethod
    def _shower(
        observer: Observer,
        streams: RayStreams,
        stacks: NDArray[np.uint8],
        wish: Wish,
        task: Task,
    ) -> Callable[[StepKernel | None], None]:
        """Tells the observer which kernel ran, and shows what it left."""

        def show(kernel: StepKernel | None) -> None:
            arrays = {name: stream.array for name, stream in streams.streams.items()}
            observer(Shown(kernel, arrays, stacks, wish.out, task.tallies))

        return show

    def _run(self, streams: RayStreams, progress: Progress | None) -> None:
        """Pass after pass, until no ray is active."""
        count = len(streams)
        counters = None if self.passes is None else self.passes.counters
        for kernel, waiting in streams.schedule(self.scheduler, self.compaction, counters):
            if progress:
                progress(count - sum(waiting), count)
            streams.run(kernel, counters)
        if progress:
            progress(count, count)


def _parts(count: int, steps: Steps) -> Iterator[slice]:
    """So many rays at a time as there is memory for."""
    each = _RAY_BYTES + steps.place.itemsize + steps.stack_bytes
    size = max(1, MAX_BYTES // each)
    for begin in range(0, count, size):
        yield slice(begin, min(begin + size, count))


def _hit_addresses(out: HitArrays | None) -> HitAddresses:
    if out is None:
        return HitAddresses(*(np.uint64(0),) * 4)
    return HitAddresses(*map(_address, out))


def _address(array: NDArray[Any] | None) -> np.uint64:
    return np.uint64(0 if array is None or array.size == 0 else array.ctypes.data)


def _at_least_one(name: str, number: int) -> int:
    number = operator.index(number)
    if number < 1:
        raise ValueError(f"{name}: expected at least 1, got {number}")
    return number
