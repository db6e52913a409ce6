"""The multipass machine: each pass runs one kernel over all rays that wait for it."""

from __future__ import annotations

import copy
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_least
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.constants import NULL
from raystream.jit.threads import Progress, parts
from raystream.kernels.hits import HitAddresses, HitArrays, Sink
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.tally import new_tallies
from raystream.machines.backend import Capabilities
from raystream.machines.local_frame_backend import LocalFrameBackend
from raystream.machines.pass_snapshot import Observer, PassSnapshot
from raystream.machines.passes import Passes
from raystream.machines.ray_block import RAYS_PER_BLOCK
from raystream.machines.ray_job import HitGoal, RayJob
from raystream.machines.ray_loop import RayLoop, eye_ray_steps, loop_arrays, loop_steps
from raystream.machines.ray_streams import RayStreams, empty_rays
from raystream.machines.records import (
    SHADE_ALL,
    SHADE_HITS,
    SHADE_NONE,
    RayState,
    StepArguments,
)
from raystream.machines.schedulers import DEFAULT_THRESHOLD, Scheduler, make_scheduler
from raystream.machines.steps import Steps, steps_of
from raystream.machines.steps.base import StepKernel
from raystream.programs.masked import with_masks
from raystream.streams import Counters
from raystream.structures import Structure

#: Memory for the rays of a query: more rays are traced in parts.
MAX_BYTES = 1 << 29

#: Bytes per ray, with counters, besides its `place` and its stack.
_RAY_BYTES = 160


class MultipassBackend(LocalFrameBackend):
    """Runs each step of a traversal as a kernel over all rays that wait for it.

    As on hardware without branching (Purcell 2002, section 2.2; Foley 2005, section 3.4): streams
    store each ray's traversal between passes, the ray's state names the kernel that it waits for,
    and a scheduler chooses the kernel of the next pass, until no ray is active.

    Parameters
    ----------
    structure : Structure
    scheduler : {"threshold", "naive", "most-work", "double"} or Scheduler
        How the next kernel is chosen; see `schedulers`.
    threshold : float
        For ``"threshold"``: the share of the active rays, 0 to 1, that must wait for an
        intersection.
    traversal_steps, intersections : int
        Steps from cell to cell or node to node, and triangle tests (in trees: of blocks of up
        to four), per ray and pass.
    compaction : bool
        Whenever half of the rays in the streams have ended their search, shade and remove them.
        Otherwise they stay, and every pass tests their state.

    Raises
    ------
    ValueError, TypeError
        If an option is out of range, or the structure is not supported.
    """

    capabilities = Capabilities(passes=True, loops=True, masks=True)

    def __init__(
        self,
        structure: Structure,
        *,
        scheduler: str | Scheduler = "threshold",
        threshold: float = DEFAULT_THRESHOLD,
        traversal_steps: int = 1,
        intersections: int = 1,
        compaction: bool = False,
    ) -> None:
        self.structure = structure
        self.scheduler = make_scheduler(scheduler, threshold)
        self.traversal_steps = check_least("traversal_steps", traversal_steps, 1)
        self.intersections = check_least("intersections", intersections, 1)
        self.compaction = bool(compaction)
        self.passes: Passes | None = None
        self.observer: Observer | None = None
        steps_of(structure)  # raises for an unsupported structure

    def recording(self, passes: Passes) -> MultipassBackend:
        """A copy that records its passes."""
        machine = copy.copy(self)
        machine.passes = passes
        return machine

    def observed_by(self, observer: Observer) -> MultipassBackend:
        """A copy that shows its rays to an observer before the first pass and after each one.

        Parameters
        ----------
        observer : callable
            Receives a `PassSnapshot`. Where rays are traced in parts, to bound memory, each part
            has its own first pass. In a renderer's loop it comes after the eye rays; where pixels
            need more room, they are then renumbered.
        """
        machine = copy.copy(self)
        machine.observer = observer
        return machine

    def answer(
        self, query: Query, rays: RayBatch, progress: Progress | None = None, records: Any = None
    ) -> Sink:
        """Run a query; see `Backend.answer`. Masks are a filter."""
        query = with_masks(query, rays, self.structure.triangles)
        return super().answer(query, rays, progress, records)

    def run_local(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query of local rays; see `LocalFrameBackend.run_local`."""
        count, kind, tallies = len(rays.t_min), query.kind, sink.tallies
        has_rows: Any = slice(None)
        if kind is Kind.MULTI_HIT:
            first, capacity = sink.splits[:-1].astype(np.uint64), np.diff(sink.splits)
            has_rows = np.flatnonzero(capacity)
        else:
            first = np.arange(count, dtype=np.uint64)
            capacity = np.full(count, query.limit if kind is Kind.COUNT_HITS else 1)
        if kind is Kind.FIRST_HIT:
            for column, miss in zip(sink.hits, (np.inf, 0.0, 0.0, -1), strict=True):
                column.fill(miss)
        out = sink.hits if kind in (Kind.FIRST_HIT, Kind.MULTI_HIT) else None
        shaded_hits = SHADE_NONE if kind is Kind.COUNT_HITS else SHADE_HITS
        job = RayJob(rays, first, capacity.astype(np.uint64), tallies).part(has_rows)
        goal = HitGoal(query.surfaces, out, shaded_hits)
        found = self._trace(steps_of(self.structure), job, goal, progress)
        if kind is Kind.ANY_HIT:
            sink.seen[:] = found != 0
        elif kind is Kind.COUNT_HITS:
            sink.counts[:] = found
        elif tallies is not None and job.tallies is not None and kind is Kind.MULTI_HIT:
            tallies[has_rows] = job.tallies  # a copy

    def _trace(
        self, steps: Steps, job: RayJob, goal: HitGoal, progress: Progress | None
    ) -> NDArray[np.uint32]:
        """Trace rays, in parts that fit in memory; returns the number of hits of each."""
        counts = np.zeros(len(job), np.uint32)
        size = max(1, MAX_BYTES // _ray_bytes(steps))
        for rows, report in parts(len(job), size, progress):
            counts[rows] = self._trace_part(steps, job.part(rows), goal, report)
        return counts

    def _trace_part(
        self, steps: Steps, job: RayJob, goal: HitGoal, progress: Progress | None
    ) -> NDArray[np.uint32]:
        """Trace rays that fit in memory."""
        runs = None if job.tallies is None else new_tallies(len(job))
        hits = None if goal.out is None else HitAddresses.of(goal.out)
        stacks, arguments = self._arguments(steps, len(job))
        arguments = arguments._replace(
            surfaces=goal.surfaces,
            shaded_hits=goal.shaded_hits,
            hits=hits,
            tallies=_address(job.tallies),
            runs=_address(runs),
        )
        streams = RayStreams.of(steps, arguments, job)
        self._observe(streams, stacks, goal.out, job.tallies)
        counters = None if self.passes is None else self.passes.counters
        self._run(streams, progress, len(job), counters)
        if progress:
            progress(len(job), len(job))
        if self.passes is not None and runs is not None:
            at_once = {"steps": self.traversal_steps, "tests": self.intersections, "": 1}
            self.passes.add_bound(steps.kernels, runs, at_once)
        streams.finish()
        return streams.counts

    def run_loop(
        self, loop: RayLoop, count: int, passes: Counter[str], progress: Progress | None = None
    ) -> None:
        """Run a renderer: eye rays, and all rays that shading spawns, in one loop.

        Parameters
        ----------
        loop : RayLoop
        count : int
            Pixels; see `loop_bytes` for the memory that each takes.
        passes : Counter
            The number of passes of each kernel is added.
        progress : callable, optional
            Called with (pixels done, pixels).

        Raises
        ------
        ValueError
            If the scheduler chooses a kernel for which no ray waits.
        """
        steps = steps_of(self.structure)
        arrays = {**empty_rays(steps, count), **loop_arrays(count, loop.pixel)}
        begun = self._streams_of(loop, eye_ray_steps(steps, loop), arrays)
        begun.run(0, None)
        passes.update(begun.passes)
        self._run_loop(loop, begun.arrays(), passes, progress, count)
        if progress:
            progress(count, count)

    def _streams_of(
        self, loop: RayLoop, steps: Steps, arrays: dict[str, NDArray[Any]]
    ) -> RayStreams:
        """The streams of a loop's rays, with stacks of their own."""
        stacks, arguments = self._arguments(steps, len(arrays["state"]))
        arguments = arguments._replace(hits=loop.hits)
        constants = {"frame": self.structure.frame, "shading": loop.shading}
        return RayStreams(steps, arguments, arrays, constants, loop.spawns, stacks)

    def _arguments(self, steps: Steps, count: int) -> tuple[NDArray[np.uint8], StepArguments]:
        """Stacks for a number of rays, and the arguments of a query that shades all of them."""
        stacks = np.empty((count, steps.stack_bytes), np.uint8)
        reach = np.float32(self.structure.triangles.max_coordinate)
        own = _address(stacks), np.uint64(steps.stack_bytes)
        at_once = np.uint64(self.traversal_steps), np.uint64(self.intersections)
        return stacks, StepArguments(reach, False, SHADE_ALL, None, NULL, NULL, *own, *at_once)

    def _run_loop(
        self,
        loop: RayLoop,
        arrays: dict[str, NDArray[Any]],
        passes: Counter[str],
        progress: Progress | None,
        total: int,
    ) -> None:
        """Run a loop whose eye rays are made, in parts where it needs more room.

        `total` is the number of all pixels, of which others are finished.
        """
        streams = self._streams_of(loop, loop_steps(steps_of(self.structure), loop), arrays)
        self._observe(streams, np.empty((0, 0), np.uint8), None, None)
        self._run(streams, progress, total, None)
        passes.update(streams.passes)
        left = streams.arrays()
        waits = left["state"] == RayState.NO_ROOM
        left = {name: array[waits] for name, array in left.items()}
        left["state"][:] = RayState.SHADING
        for part, larger in loop.grow(left["wanted"]) if waits.any() else ():
            rest = {name: np.ascontiguousarray(array[part]) for name, array in left.items()}
            self._run_loop(larger, rest, passes, progress, total)

    def working_bytes(self, kind: Kind, ray_count: int, hit_count: int) -> int:
        """See `Backend.working_bytes`."""
        steps = steps_of(self.structure)
        each = 2 * (_RAY_BYTES + steps.place.itemsize) + steps.stack_bytes
        streams = min(each * min(ray_count, RAYS_PER_BLOCK), 2 * MAX_BYTES)
        return super().working_bytes(kind, ray_count, hit_count) + streams

    def loop_bytes(self, pixel: np.dtype[Any]) -> int:
        """Memory of a pixel of `run_loop`, with the renderer's record."""
        return _ray_bytes(steps_of(self.structure)) + pixel.itemsize

    def _observe(
        self,
        streams: RayStreams,
        stacks: NDArray[np.uint8],
        hits: HitArrays | None,
        tallies: NDArray[np.uint32] | None,
    ) -> None:
        """Show the rays to the observer, if there is one: now, and after each kernel."""
        observer = self.observer
        if observer is None:
            return

        def show(kernel: StepKernel | None) -> None:
            observer(PassSnapshot(kernel, streams.arrays(), stacks, hits, tallies))

        streams.on_run = show
        show(None)

    def _run(
        self,
        streams: RayStreams,
        progress: Progress | None,
        total: int,
        counters: Counters | None,
    ) -> None:
        """Run passes until no ray is active; `total` includes rays that have ended elsewhere."""
        count = len(streams)
        for kernel, waiting in streams.schedule(self.scheduler, self.compaction, counters):
            if progress:
                progress(total - min(count, sum(waiting)), total)
            streams.run(kernel, counters)


def _ray_bytes(steps: Steps) -> int:
    """Bytes of a ray in the streams, and of its stack."""
    return _RAY_BYTES + steps.place.itemsize + steps.stack_bytes


def _address(array: NDArray[Any] | None) -> np.uint64:
    return np.uint64(0 if array is None or array.size == 0 else array.ctypes.data)
