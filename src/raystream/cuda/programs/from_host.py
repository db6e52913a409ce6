"""HostRays: programs on the device for rays in the host's memory, which are copied there."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.cuda.device_queries import DeviceScene
from raystream.cuda.device_rays import DeviceRays
from raystream.cuda.parts import parts_of
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.payload import record_of
from raystream.cuda.programs.records import aligned_records
from raystream.cuda.programs.search import Search
from raystream.cuda.programs.steps import NOTE_INVALID
from raystream.cuda.query_inputs import QueryInputs
from raystream.cuda.rays import place_rays
from raystream.jit.cuda import DeviceArray, StreamScope
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses, HitArrays, Sink, allocate_hits
from raystream.programs.filters import Filter
from raystream.programs.rows import SkipsAt
from raystream.programs.texts import Goal

__all__ = ["HostRays"]


#: What a filter's loop does, by the kind of the query.
_GOALS: dict[Kind, Goal] = {
    Kind.FIRST_HIT: "first",
    Kind.COUNT_HITS: "count",
    Kind.MULTI_HIT: "keep",
}


class _Job(NamedTuple):
    query: Query
    rays: RayBatch
    sink: Sink
    program: DeviceProgram


class HostRays:
    """Runs programs on the device for rays in the host's memory.

    Parameters
    ----------
    scene : DeviceScene
    rays_at_once : int
        Most rays that are on the device together.
    """

    def __init__(self, scene: DeviceScene, rays_at_once: int) -> None:
        self._scene, self._most = scene, rays_at_once

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> bool:
        """Answer a query with its filter or program; False if that has to stay on the CPU.

        Parameters
        ----------
        query : Query
            Of any kind but `Kind.ANY_HIT`.
        rays : RayBatch
        sink : Sink
        progress : callable, optional
            Called with (rays done, rays).
        """
        if query.kind is Kind.TRACE:
            record = record_of(sink.records)
            program = self._fitting(DeviceProgram(query.on_hit, "trace", record=record))
        else:
            program = self._filter(query.on_hit, _GOALS[query.kind])
        if program is None:
            return False
        job = _Job(query, rays, sink, program)
        if query.kind is Kind.FIRST_HIT:
            self._first_hit(job, progress)
        elif query.kind is Kind.COUNT_HITS:
            self._count_hits(job, progress)
        elif query.kind is Kind.MULTI_HIT:
            self._multi_hit(job, progress)
        else:
            self._trace(job, progress)
        return True

    def _first_hit(self, job: _Job, progress: Progress | None) -> None:
        hits, status = job.sink.hits, job.sink.status

        def run(rows: slice, work: StreamScope, rays: DeviceRays) -> None:
            memory = work.empty("hits", (4, len(rays)), np.float32)
            own = work.cleared("status", len(rays), np.uint8)
            search = self._search(work, rays, rows, job)
            search.nearest(HitAddresses.of_rows(memory.address, len(rays)), own.address)
            found = HitArrays.rows_of(work.read(memory))
            for column, values in zip(hits.part(rows), found, strict=True):
                column[:] = values
            status[rows] = work.read(own)

        self._each(job.rays, run, progress)

    def _count_hits(self, job: _Job, progress: Progress | None) -> None:
        counts = job.sink.counts

        def run(rows: slice, work: StreamScope, rays: DeviceRays) -> None:
            own = work.cleared("counts", len(rays), np.int64)
            self._search(work, rays, rows, job).count_into(own)
            counts[rows] = work.read(own)

        self._each(job.rays, run, progress)

    def _multi_hit(self, job: _Job, progress: Progress | None) -> None:
        limit, status = job.query.limit, job.sink.status
        splits, found = np.zeros(len(job.rays) + 1, np.int64), [np.empty((4, 0), np.float32)]

        def run(rows: slice, work: StreamScope, rays: DeviceRays) -> None:
            own = work.cleared("status", len(rays), np.uint8)
            work.launch(NOTE_INVALID, len(rays), (rays.source, self._scene.frame, own.address))
            search = self._search(work, rays, rows, job)
            firsts, row_count = search.keep_splits(limit)
            if row_count:
                memory = work.empty("hits", (4, row_count), np.float32)
                search.keep_rows(limit, firsts, HitAddresses.of_rows(memory.address, row_count))
                found.append(work.read(memory))
            splits[rows.start + 1 : rows.stop + 1] = splits[rows.start] + work.read(firsts)[1:]
            status[rows] = work.read(own)

        self._each(job.rays, run, progress)
        hits = allocate_hits(int(splits[-1]))
        columns = zip(*map(HitArrays.rows_of, found), strict=True)
        for column, parts in zip(hits, columns, strict=True):
            np.concatenate(parts, out=column)
        job.sink.put(splits, hits)

    def _trace(self, job: _Job, progress: Progress | None) -> None:
        records = job.sink.records

        def run(rows: slice, work: StreamScope, rays: DeviceRays) -> None:
            search = self._search(work, rays, rows, job)
            if records is None:
                search.trace(np.uint64(0), 0)
                return
            own = aligned_records(records[rows])
            placed = _copied(work, "payload", own)
            search.trace(placed.address, own[:1].nbytes)
            records[rows] = work.read(placed)

        self._each(job.rays, run, progress)

    def _filter(self, filter_: Filter, goal: Goal) -> DeviceProgram | None:
        bound = filter_.bound
        if bound is not None and bound.kept is not None:
            return None  # constants are addresses of the host's
        skips, constants = filter_.skipped is not None, None if bound is None else bound.constants
        return self._fitting(
            DeviceProgram(filter_.function, goal, skips=skips, constants=constants)
        )

    def _fitting(self, program: DeviceProgram) -> DeviceProgram | None:
        return None if program.reason_against(self._scene.gpu) else program

    def _each(
        self,
        batch: RayBatch,
        run: Callable[[slice, StreamScope, DeviceRays], None],
        progress: Progress | None,
    ) -> None:
        """Copy rays to the device, some at a time, and do something with them."""
        gpu = self._scene.gpu
        for rows in parts_of(slice(0, len(batch)), self._most):
            with StreamScope(gpu, gpu.stream) as work:
                there = place_rays(batch, rows, partial(_copied, work))
                run(rows, work, DeviceRays((rows.stop - rows.start,), there.source))
            if progress:
                progress(rows.stop, len(batch))

    def _search(self, work: StreamScope, rays: DeviceRays, rows: slice, job: _Job) -> Search:
        chosen, skips = job.query.on_hit, None
        if isinstance(chosen, Filter) and chosen.skipped is not None:
            placed = _copied(work, "skip_prim_ids", chosen.skipped[rows])
            skips = SkipsAt(placed.address, np.uint64(chosen.skipped.shape[1]))
        triangles = self._scene.in_order.place()
        inputs = QueryInputs(work, self._scene, rays)
        return Search(inputs, triangles, rows.start, job.program, job.query.surfaces, skips)


def _copied(work: StreamScope, name: str, array: NDArray[Any]) -> DeviceArray:
    """Copy an array of the host's to the device."""
    own = np.ascontiguousarray(array)
    work.keep(own)
    return work.placed(name, own)
