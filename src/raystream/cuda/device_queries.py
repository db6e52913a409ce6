"""The queries for rays that are on the device: nothing is copied, and answers stay there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.core.triangles import Triangles
from raystream.cuda.device_hits import DeviceHits, DeviceMultiHits
from raystream.cuda.device_rays import DeviceRays, place_device_rays
from raystream.cuda.parts import GROWTH, NO_TABLES, TABLE_BYTES
from raystream.cuda.ray_order import sort_rays
from raystream.cuda.scan import add_up, is_any
from raystream.cuda.structures import Resident
from raystream.cuda.threads import RETRY, SeenTables, ThreadQueries
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel, Work, stream_of
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitAddresses
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.kernels.seen import LEAST_ROOM

__all__ = ["DeviceQueries", "DeviceScene"]

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
    lists_twice : bool
        Whether rays need tables of the triangles that they have met.
    is_sorted : bool
        Whether the kernels take rays in the order of their keys, see `ray_order`.
    """

    gpu: Gpu
    kernels: ThreadQueries
    resident: Resident
    frame: SceneFrame
    triangles: Triangles
    lists_twice: bool
    is_sorted: bool = False


class DeviceQueries:
    """Answers for rays on the device, once.

    Parameters
    ----------
    scene : DeviceScene
    origins, directions, t_min, t_max
        See `place_device_rays`.

    Notes
    -----
    `first_hit` and `any_hit` return before the device is done. So does `count_hits`, but for
    structures that list a triangle twice, where it reads 8 bytes to learn whether the rays'
    tables were large enough. `multi_hit` reads the total of the counts.
    """

    def __init__(
        self, scene: DeviceScene, origins: Any, directions: Any, t_min: Any, t_max: Any
    ) -> None:
        self._scene = scene
        self._given = {
            "origins": origins,
            "directions": directions,
            "t_min": t_min,
            "t_max": t_max,
        }
        self._orders: dict[tuple[int, int], DeviceArray] = {}

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
        _report(progress, len(rays), 1)
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
        _report(progress, len(rays), 1)
        return seen

    def count_hits(self, surfaces: bool, progress: Progress | None = None) -> DeviceArray:
        """Count what lies along each ray; of the rays' shape, int64."""
        with self._work() as work:
            rays = self._rays(work)
            status = work.cleared("status", rays.shape, np.uint8)
            counts = self._count(work, rays, surfaces, UNLIMITED, status)
        _report(progress, len(rays), 1)
        return counts.shaped(rays.shape)

    def multi_hit(
        self, surfaces: bool, limit: int, progress: Progress | None = None
    ) -> DeviceMultiHits:
        """Find the nearest `limit` hits of each ray, by t, then prim_id.

        Raises
        ------
        ValueError, TypeError, CudaError
            See `place_device_rays`; or if there is no memory for the hits.
        """
        with self._work() as work:
            rays = self._rays(work)
            count = len(rays)
            status = work.cleared("status", rays.shape, np.uint8)
            # Hits that nobody wants are looked for, too: it tells which rays are invalid.
            counts = self._count(work, rays, surfaces, max(limit, 1), status)
            if limit == 0:
                work.gpu.clear(counts, work.stream)
            splits = work.empty("splits", count + 1, np.int64)
            add_up(work, counts, splits)
            row_count = int(work.read(splits.part(count, 1))[0])
            _report(progress, count, 2)
            t, u, v = (work.empty("hits", row_count, np.float32) for _ in "tuv")
            prim_id = work.empty("hits", row_count, np.int32)
            to = HitAddresses(t.address, u.address, v.address, prim_id.address)
            if row_count:
                self._fill(work, rays, surfaces, splits, to)
        if progress:
            progress(2 * count, 2 * count)
        hits = t, u, v, prim_id
        return DeviceMultiHits(splits, *hits, status, self._scene.triangles)

    def _work(self) -> Work:
        self._orders = {}
        gpu = self._scene.gpu
        return Work(gpu, stream_of(gpu, self._given))

    def _rays(self, work: Work) -> DeviceRays:
        return place_device_rays(work, **self._given)

    def _shared(self, work: Work, rays: DeviceRays, first: int, count: int) -> tuple[Any, ...]:
        """What kernels are given for some of the rays before anything else."""
        source = rays.source_from(first)
        shared = source, self._scene.frame, self._scene.resident.tree, None
        return *self._order(work, source, first, count), *shared

    def _order(
        self, work: Work, source: RaySource, first: int, count: int
    ) -> tuple[np.uint64, ...]:
        """The address of the order in which some rays are taken, which are sorted once."""
        if not self._scene.is_sorted:
            return ()
        if (first, count) not in self._orders:
            frame, gpu = self._scene.frame, work.gpu
            order = sort_rays(gpu, source, count, frame, work.ready, work.stream)
            self._orders[first, count] = order
        return (self._orders[first, count].address,)

    def _run(self, work: Work, rays: DeviceRays, kernel: RangeKernel, to: Any) -> None:
        count = len(rays)
        work.launch(kernel, count, (*self._shared(work, rays, 0, count), to))

    def _count(
        self, work: Work, rays: DeviceRays, surfaces: bool, limit: int, status: DeviceArray
    ) -> DeviceArray:
        counts = work.empty("counts", len(rays), np.int64)

        def run(tables: SeenTables, first: int, count: int) -> None:
            wanted = bool(surfaces), np.uint64(limit)
            places = _moved(status, first), _moved(counts, first)
            arguments = (*self._shared(work, rays, first, count), tables, *wanted, *places)
            work.launch(self._scene.kernels.count_hits, count, arguments)

        self._with_tables(work, counts, run)
        return counts

    def _fill(
        self, work: Work, rays: DeviceRays, surfaces: bool, splits: DeviceArray, to: HitAddresses
    ) -> None:
        found = work.empty("counts", len(rays), np.int64)

        def run(tables: SeenTables, first: int, count: int) -> None:
            more = bool(surfaces), _moved(splits, first), to, _moved(found, first)
            arguments = (*self._shared(work, rays, first, count), tables, *more)
            work.launch(self._scene.kernels.multi_hit, count, arguments)

        self._with_tables(work, found, run)

    def _with_tables(
        self, work: Work, counts: DeviceArray, run: Callable[[SeenTables, int, int], None]
    ) -> None:
        """Run a kernel for all rays, in parts that have tables, until these are large enough."""
        ray_count = len(counts)
        if not self._scene.lists_twice:
            run(NO_TABLES, 0, ray_count)
            return
        room = int(LEAST_ROOM)
        while True:
            most = max(TABLE_BYTES // (4 * room + 4), 1)
            shape = min(most, ray_count), room + 1
            memory = work.empty("tables of triangles seen", shape, np.int32)
            tables = SeenTables(memory.address, np.uint64(room))
            for first in range(0, ray_count, most):
                run(tables, first, min(most, ray_count - first))
            if not is_any(work, counts, RETRY):
                return
            room *= GROWTH


def _moved(array: DeviceArray, first: int) -> np.uint64:
    """Address of one of an array's numbers."""
    return array.address + np.uint64(first * array.dtype.itemsize)


def _report(progress: Progress | None, count: int, passes: int) -> None:
    """Say that a pass was begun: the device may still be at it."""
    if progress:
        progress(count, passes * count)
