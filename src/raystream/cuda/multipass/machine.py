"""The multipass machine on CUDA: in each pass one kernel, chosen by the device."""

from __future__ import annotations

import copy
import inspect
import operator
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.choices import Multipass as MultipassOptions
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.cuda.backend import CudaBackend
from raystream.cuda.multipass.control import (
    LoggedPass,
    read_active,
    read_passes,
    rules_of,
)
from raystream.cuda.multipass.kernels.rays import FINISH, FINISH_MANY, Wanted
from raystream.cuda.multipass.loops import LOOPS
from raystream.cuda.multipass.passes import columns_of
from raystream.cuda.multipass.query_parts import HostQuery, QueryPart
from raystream.cuda.multipass.ray_streams import HitGoal, RayStreams, ray_bytes
from raystream.cuda.rays import split_rows
from raystream.cuda.structures import Resident
from raystream.jit.constants import NULL
from raystream.jit.cuda import CudaError, DeviceArray, Gpu
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses, HitArrays, Sink
from raystream.machines.backend import Backend, Capabilities
from raystream.machines.passes import Passes
from raystream.machines.records import SHADE_HITS, SHADE_NONE
from raystream.machines.schedulers import SCHEDULERS
from raystream.machines.steps import steps_of
from raystream.machines.steps.base import StepKernel, Steps
from raystream.streams import Pass
from raystream.structures import Structure

__all__ = ["MAX_PASSES", "Multipass"]

#: Default maximum number of passes.
MAX_PASSES = 1 << 20

#: Default maximum number of rays traced together, and of bytes for their streams.
_RAYS_AT_ONCE = 1 << 21
_MOST_BYTES = 1 << 31

_ONE_EACH = Wanted(NULL, np.uint64(1))


class Multipass(CudaBackend):
    """Runs each step of a traversal over all rays that wait for it, on a GPU.

    Like `machines.multipass.MultipassBackend`, with the same kernels, states, schedulers and
    passes, except that the device counts the waiting rays and chooses the kernel (`control`), and
    the host only occasionally checks whether rays are active.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; its arrays are copied to the device.
    gpu : Gpu
    loop : str
        One of `loops.LOOPS`.
    max_passes : int
        Maximum number of passes for rays that are traced together.
    rays_at_once : int
        Maximum number of rays that are traced together.
    **options
        See `core.choices.Multipass`. Scheduler objects are supported on the CPU only. With
        compaction, threads for removed rays run until the host compacts the streams.

    Raises
    ------
    CudaError
        If device memory runs out; when tracing, also if rays are left after `max_passes`.
    ValueError, TypeError
        If an option is out of range, or the structure is not supported.
    """

    capabilities = Capabilities(device_arrays=True, passes=True)

    reads_own_layout = True

    def __init__(
        self,
        structure: Structure,
        gpu: Gpu,
        *,
        loop: str = "graph",
        max_passes: int = MAX_PASSES,
        rays_at_once: int = _RAYS_AT_ONCE,
        **options: Any,
    ) -> None:
        given = MultipassOptions(**options)
        scheduler = given.scheduler
        if not isinstance(scheduler, str):
            known = ", ".join(map(repr, SCHEDULERS))
            raise TypeError(
                f"scheduler: the device supports {known}; {scheduler!r:.60} needs device='cpu'"
            )
        if loop not in list(LOOPS):
            raise ValueError(f"loop: expected one of {', '.join(map(repr, LOOPS))}, got {loop!r}")
        steps = steps_of(structure)
        self.loop = loop
        self.traversal_steps = given.traversal_steps
        self.intersections = given.intersections
        self.max_passes = _at_least_one("max_passes", max_passes)
        self.compaction = given.compaction
        self.passes: Passes | None = None
        self._rules = rules_of(steps.kernels, scheduler, given.threshold, self.compaction)
        super().__init__(structure, gpu, rays_at_once=rays_at_once)
        self._steps = _on_device(steps, structure, self._scene.resident)

    def recording(self, passes: Passes) -> Multipass:
        """A copy of the machine that adds its passes to a record."""
        machine = copy.copy(self)
        machine.passes = passes
        return machine

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query of rays in host memory; see `Backend.run`."""
        frame = self.structure.frame
        if query.kind is Kind.MULTI_HIT:
            filled, half = self.room_for_hits(query, rays, sink, progress)
            self._multi_hit(HostQuery(query, rays, frame, filled, half))
            sink.put(filled.splits, filled.hits)
            return
        job = HostQuery(query, rays, frame, sink, progress)
        if query.kind is Kind.FIRST_HIT:
            self._first_hit(job)
        elif query.kind is Kind.ANY_HIT:
            self._any_hit(job)
        else:
            self._count_hits(job)

    # Programs run on the CPU, at hits that the passes found.
    run_program = Backend.run_program

    def _first_hit(self, job: HostQuery) -> None:
        out = job.sink.hits
        for part in self._parts(job):
            memory, hits = _hits_of(self.gpu, part.count)
            goal = HitGoal(False, SHADE_HITS, _ONE_EACH, hits=hits)
            streams = self._run_all(part, goal, job)
            FINISH.launch(self.gpu, part.count, (streams.addresses, hits))
            _copy(memory, out.part(part.rows))
            _finish(part, job)

    def _any_hit(self, job: HostQuery) -> None:
        seen = job.sink.seen
        for part in self._parts(job):
            goal = HitGoal(False, SHADE_HITS, _ONE_EACH)
            seen[part.rows] = self._run_all(part, goal, job).counts() != 0
            _finish(part, job)

    def _count_hits(self, job: HostQuery) -> None:
        counts, query = job.sink.counts, job.query
        for part in self._parts(job):
            goal = HitGoal(query.surfaces, SHADE_NONE, Wanted(NULL, np.uint64(query.limit)))
            counts[part.rows] = self._run_all(part, goal, job).counts()
            _finish(part, job)

    def _multi_hit(self, job: HostQuery) -> None:
        splits, out = job.sink.splits, job.sink.hits
        for part in self._parts(job, splits):
            wanted = splits[part.rows.start : part.rows.stop + 1]
            capacity = np.diff(wanted)
            rows = slice(int(wanted[0]), int(wanted[-1]))
            own = self.gpu.upload("splits", wanted - wanted[0])
            memory, hits = _hits_of(self.gpu, rows.stop - rows.start)
            want_any = None if capacity.all() else np.flatnonzero(capacity).astype(np.uint32)
            each = Wanted(own.address, NULL)
            goal = HitGoal(job.query.surfaces, SHADE_HITS, each, want_any, hits)
            streams = self._run_all(part, goal, job)
            FINISH_MANY.launch(self.gpu, part.count, (streams.addresses, goal.wanted, hits))
            counts = streams.counts()
            counts[capacity == 0] = 0
            if not np.array_equal(counts, capacity):
                raise CudaError(
                    f"device 'cuda': {self.gpu.name} found fewer hits than it had counted"
                )
            _copy(memory, out.part(rows))
            _finish(part, job)

    def _parts(
        self, job: HostQuery, splits: NDArray[np.int64] | None = None
    ) -> Iterator[QueryPart]:
        """Parts of the rays that fit in device memory."""
        byte_count = min(_MOST_BYTES, self.gpu.byte_count // 4)
        most = max(1, min(self.rays_at_once, byte_count // ray_bytes(self._steps)))
        for rows in split_rows(slice(0, len(job.batch)), most, splits):
            yield QueryPart(job, rows, self.gpu)

    def _run_all(self, part: QueryPart, goal: HitGoal, job: HostQuery) -> RayStreams:
        """Trace the rays of a part until all have ended."""
        streams = RayStreams(
            self.gpu,
            self._steps,
            part,
            goal,
            (self.traversal_steps, self.intersections),
            np.float32(self.structure.triangles.max_coordinate),
        )
        if streams.length:
            self._run(streams, part, job)
            runs = streams.runs()
            if self.passes is not None and runs is not None:
                at_once = {"steps": self.traversal_steps, "tests": self.intersections, "": 1}
                self.passes.add_bound(self._steps.kernels, runs, at_once)
        return streams

    def _run(self, streams: RayStreams, part: QueryPart, job: HostQuery) -> None:
        """Run passes until all rays have ended; the host checks progress between them."""
        loop, known = LOOPS[self.loop](streams, self._rules), 0
        while True:
            words = loop.run(self.max_passes - known)
            ran = read_passes(words, known)
            known += len(ran)
            self._note(ran)
            active = read_active(words)
            if job.progress:
                job.progress(part.rows.stop - active, len(job.batch))
            if not active:
                return
            if known >= self.max_passes:
                raise CudaError(
                    f"device 'cuda', machine 'multipass': {active:,} rays are still active after "
                    f"{known:,} passes; max_passes is {self.max_passes:,}"
                )
            if self.compaction and 2 * active <= streams.length:
                streams.drop_ended(active)
                loop.renew()

    def _note(self, ran: Sequence[LoggedPass]) -> None:
        if self.passes is not None:
            words = _words_of(self._steps)
            for one in ran:
                kernel = self._steps.kernels[one.kernel]
                self.passes.counters.passes.append(_pass(kernel, one, words))


def _on_device(steps: Steps, structure: Structure, resident: Resident) -> Steps:
    """The steps with addresses in GPU memory."""
    names = structure.memory.keys() & set(steps.tree._fields)
    return steps._replace(
        tree=steps.tree._replace(**{name: getattr(resident.tree, name) for name in names})
    )


def _words_of(steps: Steps) -> dict[str, int]:
    """Number of words in each stream's records."""
    return {name: columns.layout.word_count for name, columns in columns_of(steps).items()}


def _pass(kernel: StepKernel, ran: LoggedPass, words: dict[str, int]) -> Pass:
    """The record of a pass, as `streams.Kernel` would make it."""
    count = ran.run_count
    names = inspect.signature(kernel.function).parameters
    read = {name: count * words[name] for name in names if name in words}
    written = {name: count * words[name] for name in kernel.outputs}
    return Pass(
        kernel.name,
        ran.record_count,
        count,
        count,
        {**read, "state": ran.record_count},
        {**written, "state": count},
    )


def _finish(part: QueryPart, job: HostQuery) -> None:
    """Copy back status and tallies."""
    part.finish()
    if job.progress:
        job.progress(part.rows.stop, len(job.batch))


def _hits_of(gpu: Gpu, count: int) -> tuple[DeviceArray, HitAddresses]:
    """Allocate memory for hits; returns it with the addresses of its rows."""
    memory = gpu.empty("hits", (4, count), np.float32)
    return memory, HitAddresses(*(memory.address + np.uint64(4 * count * k) for k in range(4)))


def _copy(hits: DeviceArray, out: HitArrays) -> None:
    for column, row in zip(out, HitArrays.rows_of(hits.host()), strict=True):
        column[:] = row


def _at_least_one(name: str, number: int) -> int:
    number = operator.index(number)
    if number < 1:
        raise ValueError(f"{name}: expected at least 1, got {number}")
    return number
