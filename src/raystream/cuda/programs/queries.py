"""ProgramQueries: the queries for rays that are on the device, with filters, and traces."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayArrays
from raystream.cuda.device_hits import DeviceHits, DeviceMultiHits
from raystream.cuda.device_queries import DeviceQueries, DeviceScene, report
from raystream.cuda.device_rays import DeviceRays
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.payload import place_payload
from raystream.cuda.programs.search import Search
from raystream.cuda.programs.skips import place_skips
from raystream.cuda.programs.steps import IS_HIT, NOTE_INVALID
from raystream.cuda.query_inputs import QueryInputs
from raystream.jit.cuda import DeviceArray, StreamScope
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses
from raystream.programs.filters import Filter
from raystream.programs.texts import Goal

__all__ = ["ProgramQueries", "program_of"]


class ProgramQueries(DeviceQueries):
    """Answers for rays on the device, where some hits do not exist; once.

    Parameters
    ----------
    scene : DeviceScene
    query : Query
        Triangles that its filter skips are as the caller gave them.
    rays : RayArrays
        See `place_device_rays`.

    Notes
    -----
    A query waits for the device after each round of its program.
    """

    def __init__(self, scene: DeviceScene, query: Query, rays: RayArrays) -> None:
        super().__init__(scene, query, rays)
        self._filter: Filter | None = None if query.kind is Kind.TRACE else query.on_hit

    def first_hit(self, progress: Progress | None = None) -> DeviceHits:
        """Find the nearest triangle along each ray that exists; see `DeviceQueries.first_hit`.

        Raises
        ------
        TypeError
            If the filter cannot run on the device.
        """
        if self._filter is None:
            return super().first_hit(progress)
        with self._work() as work:
            hits = self._nearest(work, self._rays(work))
        report(progress, hits.t.size, 1)
        return hits

    def any_hit(self, progress: Progress | None = None) -> DeviceArray:
        """Find whether anything that exists is in each ray's way; of the rays' shape, bool."""
        if self._filter is None:
            return super().any_hit(progress)
        with self._work() as work:
            rays = self._rays(work)
            hits = self._nearest(work, rays)
            seen = work.empty("answers", rays.shape, np.bool_)
            work.launch(IS_HIT, len(rays), (hits.prim_id.address, seen.address))
        report(progress, len(rays), 1)
        return seen

    def count_hits(self, progress: Progress | None = None) -> DeviceArray:
        """Count what exists along each ray; of the rays' shape, int64."""
        if self._filter is None:
            return super().count_hits(progress)
        with self._work() as work:
            rays = self._rays(work)
            counts = work.cleared("counts", len(rays), np.int64)
            self._search(work, rays, "count").count_into(counts)
        report(progress, len(rays), 1)
        return counts.shaped(rays.shape)

    def multi_hit(self, progress: Progress | None = None) -> DeviceMultiHits:
        """Find the nearest `limit` hits of each ray that exist; see `DeviceQueries.multi_hit`."""
        limit = self._query.limit
        if self._filter is None or limit == 0:
            return super().multi_hit(progress)
        with self._work() as work:
            rays = self._rays(work)
            search = self._search(work, rays, "keep")
            status = work.cleared("status", rays.shape, np.uint8)
            work.launch(NOTE_INVALID, len(rays), (rays.source, self._scene.frame, status.address))
            splits, row_count = search.keep_splits(limit)
            report(progress, len(rays), 2)
            t, u, v = (work.empty("hits", row_count, np.float32) for _ in "tuv")
            prim_id = work.empty("hits", row_count, np.int32)
            hits = t, u, v, prim_id
            if row_count:
                search.keep_rows(limit, splits, HitAddresses(*(one.address for one in hits)))
        if progress:
            progress(2 * len(rays), 2 * len(rays))
        return DeviceMultiHits(splits, *hits, status, self._scene.triangles)

    def trace(self, payload: Any, progress: Progress | None = None) -> Any:
        """Run a program at the hits of each ray.

        Parameters
        ----------
        payload : array, dtype or None
            An array on the device is changed there. A NumPy array is copied there and back. A
            dtype makes an array of zeros on the device.

        Returns
        -------
        DeviceArray, array or None
            The payload: the array that was given, or the new one.

        Raises
        ------
        ValueError, TypeError
            See `place_payload`; or if the program cannot run on the device.
        """
        with self._work() as work:
            rays = self._rays(work)
            placed = place_payload(work, payload, rays.shape)
            program = program_of(self._scene, self._query.on_hit, "trace", record=placed.record)
            triangles = self._scene.in_order.place()
            inputs = QueryInputs(work, self._scene, rays)
            search = Search(inputs, triangles, 0, program, self._query.surfaces)
            search.trace(placed.address, placed.record_bytes)
            placed.finish(work)
        report(progress, len(rays), 1)
        return placed.result

    def _nearest(self, work: StreamScope, rays: DeviceRays) -> DeviceHits:
        search = self._search(work, rays, "first")
        t, u, v = (work.empty(name, rays.shape, np.float32) for name in "tuv")
        prim_id = work.empty("prim_id", rays.shape, np.int32)
        status = work.cleared("status", rays.shape, np.uint8)
        hits = t, u, v, prim_id
        search.nearest(HitAddresses(*(one.address for one in hits)), status.address)
        return DeviceHits(*hits, status, self._scene.triangles)

    def _search(self, work: StreamScope, rays: DeviceRays, goal: Goal) -> Search:
        assert self._filter is not None
        scene, chosen = self._scene, self._filter
        program = program_of(scene, chosen.function, goal, chosen.skipped is not None, chosen)
        skips = place_skips(work, chosen.skipped, rays.shape, len(scene.triangles))
        inputs = QueryInputs(work, scene, rays)
        placed = scene.in_order.place()
        return Search(inputs, placed, 0, program, self._query.surfaces, skips)


def program_of(
    scene: DeviceScene,
    function: Any,
    goal: Goal,
    skips: bool = False,
    chosen: Filter | None = None,
    record: Any = None,
) -> DeviceProgram:
    """A program that runs on the device.

    Raises
    ------
    TypeError
        If it does not.
    """
    bound = None if chosen is None else chosen.bound
    constants = None if bound is None else bound.constants
    program = DeviceProgram(function, goal, skips=skips, constants=constants, record=record)
    reason = program.reason_against(scene.gpu)
    if bound is not None and bound.kept is not None:
        reason = "its constants are addresses of the host's"
    if reason is not None:
        raise TypeError(
            f"{program.name}: cannot run on the GPU, where the rays are: {reason}; "
            "copy the rays to the host, then the processor runs it"
        )
    return program
