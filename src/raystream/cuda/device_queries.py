"""The queries for rays that are on the device: nothing is copied, and answers stay there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import UNLIMITED, Kind, Query
from raystream.core.rays import RayArrays
from raystream.core.triangles import Triangles
from raystream.cuda.device_hits import DeviceHits, DeviceMultiHits
from raystream.cuda.device_rays import DeviceRays, place_device_rays
from raystream.cuda.query_inputs import QueryInputs
from raystream.cuda.scan import add_up
from raystream.cuda.structures import Resident
from raystream.cuda.tables import with_tables
from raystream.cuda.threads import SeenTables, ThreadQueries
from raystream.cuda.triangles import DeviceTriangles
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel, StreamScope, stream_of
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import ResultAddresses

__all__ = ["DeviceQueries", "DeviceScene", "report"]

_NOWHERE = np.uint64(0)


class DeviceScene(NamedTuple):
    """What rays are traced against on a device.

    Attributes
    ----------
    gpu : Gpu
    kernels : ThreadQueries
    resident : Resident
    frame : SceneFrame
    triangles : Triangles
    has_duplicates : bool
        Whether rays need tables of the triangles that they have met.
    is_sorted : bool
        Whether the kernels take rays in the order of their keys, see `ray_order`.
    in_order : DeviceTriangles
        The triangles for programs.
    """

    gpu: Gpu
    kernels: ThreadQueries
    resident: Resident
    frame: SceneFrame
    triangles: Triangles
    has_duplicates: bool
    is_sorted: bool
    in_order: DeviceTriangles


class DeviceQueries:
    """Answers for rays on the device, once.

    Parameters
    ----------
    scene : DeviceScene
    query : Query
    rays : RayArrays
        See `place_device_rays`.

    Notes
    -----
    `first_hit` and `any_hit` return before the device is done. So does `count_hits`, but for
    structures that list a triangle twice, where it reads 8 bytes to learn whether the rays'
    tables were large enough. `multi_hit` reads the total of the counts.
    """

    def __init__(self, scene: DeviceScene, query: Query, rays: RayArrays) -> None:
        self._scene = scene
        self._query = query
        self._given = rays._asdict()

    def answer(self, progress: Progress | None = None, payload: Any = None) -> Any:
        """Answer the query; `payload` is that of `trace`."""
        kind = self._query.kind
        if kind is Kind.FIRST_HIT:
            return self.first_hit(progress)
        if kind is Kind.ANY_HIT:
            return self.any_hit(progress)
        if kind is Kind.COUNT_HITS:
            return self.count_hits(progress)
        if kind is Kind.MULTI_HIT:
            return self.multi_hit(progress)
        return self.trace(payload, progress)

    def trace(self, payload: Any, progress: Progress | None = None) -> Any:
        """Run a program at the hits of each ray."""
        raise NotImplementedError

    def first_hit(self, progress: Progress | None = None) -> DeviceHits:
        """Find the nearest triangle along each ray.

        Raises
        ------
        ValueError, TypeError, CudaError
            See `place_device_rays`.
        """
        with self._work() as work:
            rays = self._rays(work)
            t, u, v = (work.empty(name, rays.shape, np.float32) for name in "tuv")
            prim_id = work.empty("prim_id", rays.shape, np.int32)
            status = work.cleared("status", rays.shape, np.uint8)
            places = t.address, u.address, v.address, prim_id.address
            to = ResultAddresses(*places, _NOWHERE, status.address)
            self._run(work, rays, self._scene.kernels.first_hit, to)
        report(progress, len(rays), 1)
        return DeviceHits(t, u, v, prim_id, status, self._scene.triangles)

    def any_hit(self, progress: Progress | None = None) -> DeviceArray:
        """Find whether anything is in each ray's way; of the rays' shape, bool."""
        with self._work() as work:
            rays = self._rays(work)
            seen = work.empty("answers", rays.shape, np.bool_)
            status = work.cleared("status", rays.shape, np.uint8)
            nowhere = _NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE
            to = ResultAddresses(*nowhere, seen.address, status.address)
            self._run(work, rays, self._scene.kernels.any_hit, to)
        report(progress, len(rays), 1)
        return seen

    def count_hits(self, progress: Progress | None = None) -> DeviceArray:
        """Count what lies along each ray; of the rays' shape, int64."""
        with self._work() as work:
            rays = self._rays(work)
            status = work.cleared("status", rays.shape, np.uint8)
            inputs = QueryInputs(work, self._scene, rays)
            counts = self._count(work, inputs, UNLIMITED, status)
        report(progress, len(rays), 1)
        return counts.shaped(rays.shape)

    def multi_hit(self, progress: Progress | None = None) -> DeviceMultiHits:
        """Find the nearest `limit` hits of each ray, by t, then prim_id.

        Raises
        ------
        ValueError, TypeError, CudaError
            See `place_device_rays`; or if there is no memory for the hits.
        """
        limit = self._query.limit
        with self._work() as work:
            rays = self._rays(work)
            count = len(rays)
            status = work.cleared("status", rays.shape, np.uint8)
            # Hits that nobody wants are looked for, too: it tells which rays are invalid.
            inputs = QueryInputs(work, self._scene, rays)
            counts = self._count(work, inputs, max(limit, 1), status)
            if limit == 0:
                work.gpu.clear(counts, work.stream)
            splits = work.empty("splits", count + 1, np.int64)
            add_up(work, counts, splits)
            row_count = int(work.read(splits.part(count, 1))[0])
            report(progress, count, 2)
            t, u, v = (work.empty("hits", row_count, np.float32) for _ in "tuv")
            prim_id = work.empty("hits", row_count, np.int32)
            to = HitAddresses(t.address, u.address, v.address, prim_id.address)
            if row_count:
                self._fill(work, inputs, splits, to)
        if progress:
            progress(2 * count, 2 * count)
        hits = t, u, v, prim_id
        return DeviceMultiHits(splits, *hits, status, self._scene.triangles)

    def _work(self) -> StreamScope:
        gpu = self._scene.gpu
        return StreamScope(gpu, stream_of(gpu, self._given))

    def _rays(self, work: StreamScope) -> DeviceRays:
        return place_device_rays(work, **self._given)

    def _run(self, work: StreamScope, rays: DeviceRays, kernel: RangeKernel, to: Any) -> None:
        inputs = QueryInputs(work, self._scene, rays)
        work.launch(kernel, len(inputs), (*inputs.shared(0, len(inputs)), to))

    def _count(
        self, work: StreamScope, inputs: QueryInputs, limit: int, status: DeviceArray
    ) -> DeviceArray:
        counts = work.empty("counts", len(inputs), np.int64)

        def run(tables: SeenTables, first: int, count: int) -> None:
            wanted = bool(self._query.surfaces), np.uint64(limit)
            places = _moved(status, first), _moved(counts, first)
            arguments = (*inputs.shared(first, count), tables, *wanted, *places)
            work.launch(self._scene.kernels.count_hits, count, arguments)

        with_tables(work, self._scene.has_duplicates, counts, run)
        return counts

    def _fill(
        self, work: StreamScope, inputs: QueryInputs, splits: DeviceArray, to: HitAddresses
    ) -> None:
        found = work.empty("counts", len(inputs), np.int64)

        def run(tables: SeenTables, first: int, count: int) -> None:
            more = bool(self._query.surfaces), _moved(splits, first), to, _moved(found, first)
            arguments = (*inputs.shared(first, count), tables, *more)
            work.launch(self._scene.kernels.multi_hit, count, arguments)

        with_tables(work, self._scene.has_duplicates, found, run)


def _moved(array: DeviceArray, first: int) -> np.uint64:
    """Address of one of an array's numbers."""
    return array.address + np.uint64(first * array.dtype.itemsize)


def report(progress: Progress | None, count: int, passes: int) -> None:
    """Say that a pass was begun: the device may still be at it."""
    if progress:
        progress(count, passes * count)
