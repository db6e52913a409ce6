"""HostRays: programs at the hits of the host's rays: these travel there, and what comes of them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.cuda.asking import Asking
from raystream.cuda.device_queries import DeviceScene
from raystream.cuda.device_rays import DeviceRays
from raystream.cuda.parts import parts_of
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.payload import record_of
from raystream.cuda.programs.records import aligned_records
from raystream.cuda.programs.search import Search
from raystream.cuda.programs.steps import NOTE_INVALID
from raystream.cuda.rays import place_rays
from raystream.jit.cuda import DeviceArray, Work
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitAddresses, HitArrays
from raystream.programs.filters import Filter
from raystream.programs.rows import SkipsAt
from raystream.programs.texts import Goal
from raystream.structures.found import allocate_hits

__all__ = ["HostRays"]


class HostRays:
    """Runs programs on the device for rays of the host's.

    Each query returns None if its function has to stay on the CPU: then nothing was done.

    Parameters
    ----------
    scene : DeviceScene
    rays_at_once : int
        Most rays that are on the device together.
    """

    def __init__(self, scene: DeviceScene, rays_at_once: int) -> None:
        self._scene, self._most = scene, rays_at_once

    def first_hit(
        self,
        filter_: Filter,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> HitArrays | None:
        """Find the nearest hit of each ray that exists; see `BatchQueries.first_hit_batch`."""
        program = self._filter(filter_, "first")
        if program is None:
            return None
        hits = HitArrays.empty(len(batch))

        def run(rows: slice, work: Work, rays: DeviceRays) -> None:
            memory = work.empty("hits", (4, len(rays)), np.float32)
            own = work.cleared("status", len(rays), np.uint8)
            search = self._search(work, rays, rows, program, filter_)
            search.nearest(HitAddresses.of_rows(memory.address, len(rays)), own.address)
            found = HitArrays.rows_of(work.read(memory))
            for column, values in zip(hits.part(rows), found, strict=True):
                column[:] = values
            status[rows] = work.read(own)

        self._each(batch, run, progress)
        return hits

    def count_hits(
        self,
        filter_: Filter,
        batch: RayBatch,
        surfaces: bool,
        progress: Progress | None = None,
    ) -> NDArray[np.int64] | None:
        """Count the hits of each ray that exist; of shape (N,)."""
        program = self._filter(filter_, "count")
        if program is None:
            return None
        counts = np.empty(len(batch), np.int64)

        def run(rows: slice, work: Work, rays: DeviceRays) -> None:
            own = work.cleared("counts", len(rays), np.int64)
            self._search(work, rays, rows, program, filter_, surfaces).count_into(own)
            counts[rows] = work.read(own)

        self._each(batch, run, progress)
        return counts

    def multi_hit(
        self,
        filter_: Filter,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> tuple[NDArray[np.int64], HitArrays] | None:
        """Find the nearest hits of each ray that exist; see `BatchQueries.multi_hit_batch`."""
        program = self._filter(filter_, "keep")
        if program is None:
            return None
        splits, found = np.zeros(len(batch) + 1, np.int64), [np.empty((4, 0), np.float32)]

        def run(rows: slice, work: Work, rays: DeviceRays) -> None:
            own = work.cleared("status", len(rays), np.uint8)
            work.launch(NOTE_INVALID, len(rays), (rays.source, self._scene.frame, own.address))
            search = self._search(work, rays, rows, program, filter_, surfaces)
            firsts, row_count = search.keep_splits(limit)
            if row_count:
                memory = work.empty("hits", (4, row_count), np.float32)
                search.keep_rows(limit, firsts, HitAddresses.of_rows(memory.address, row_count))
                found.append(work.read(memory))
            splits[rows.start + 1 : rows.stop + 1] = splits[rows.start] + work.read(firsts)[1:]
            status[rows] = work.read(own)

        self._each(batch, run, progress)
        hits = allocate_hits(int(splits[-1]))
        columns = zip(*map(HitArrays.rows_of, found), strict=True)
        for column, parts in zip(hits, columns, strict=True):
            np.concatenate(parts, out=column)
        return splits, hits

    def trace(
        self,
        batch: RayBatch,
        function: Callable[..., Any],
        records: NDArray[Any] | None,
        surfaces: bool,
        progress: Progress | None = None,
    ) -> bool:
        """Run a program at the hits of each ray; whether it runs there.

        Parameters
        ----------
        batch : RayBatch
        function : callable
        records : ndarray of shape (N,) or (N, k), or None
            In C order; changed.
        surfaces : bool
        progress : callable, optional
        """
        program = self._fitting(DeviceProgram(function, "trace", record=record_of(records)))
        if program is None:
            return False

        def run(rows: slice, work: Work, rays: DeviceRays) -> None:
            search = self._search(work, rays, rows, program, None, surfaces)
            if records is None:
                search.trace(np.uint64(0), 0)
                return
            own = aligned_records(records[rows])
            placed = _copied(work, "payload", own)
            search.trace(placed.address, own[:1].nbytes)
            records[rows] = work.read(placed)

        self._each(batch, run, progress)
        return True

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
        run: Callable[[slice, Work, DeviceRays], None],
        progress: Progress | None,
    ) -> None:
        """Copy rays to the device, some at a time, and do something with them."""
        gpu = self._scene.gpu
        for rows in parts_of(slice(0, len(batch)), self._most):
            with Work(gpu, gpu.stream) as work:
                there = place_rays(batch, rows, partial(_copied, work))
                run(rows, work, DeviceRays((rows.stop - rows.start,), there.source))
            if progress:
                progress(rows.stop, len(batch))

    def _search(
        self,
        work: Work,
        rays: DeviceRays,
        rows: slice,
        program: DeviceProgram,
        filter_: Filter | None,
        surfaces: bool = False,
    ) -> Search:
        skips = None
        if filter_ is not None and filter_.skipped is not None:
            placed = _copied(work, "skip_prim_ids", filter_.skipped[rows])
            skips = SkipsAt(placed.address, np.uint64(filter_.skipped.shape[1]))
        triangles = self._scene.in_order.place()
        asking = Asking(work, self._scene, rays)
        return Search(asking, triangles, rows.start, program, surfaces, skips)


def _copied(work: Work, name: str, array: NDArray[Any]) -> DeviceArray:
    """Copy an array of the host's to the device."""
    own = np.ascontiguousarray(array)
    work.keep(own)
    return work.placed(name, own)
