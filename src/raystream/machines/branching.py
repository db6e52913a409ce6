"""The branching machine on the CPU: each ray from start to end, rays divided among threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.constants import NULL
from raystream.jit.threads import Progress, rising, thread_count
from raystream.kernels.aligned import array_address, array_places
from raystream.kernels.growing_buffers import GrowingBuffers
from raystream.kernels.hits import HitAccumulator, HitArrays, HitBatch, Sink, allocate_hits
from raystream.kernels.point_queries import (
    POINTS_PER_CALL,
    NearestArrays,
    PointBatch,
    PointScene,
    step_of,
    work_bytes,
)
from raystream.kernels.queries import HitLimits, RayScene, output_of
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.machines.backend import Backend, Capabilities
from raystream.machines.batch import batch_bytes, run_calls, trace_batch
from raystream.programs.run import run_on_hits
from raystream.structures import Structure, form_of
from raystream.structures.base import RAYS_PER_CALL

#: Initial capacity in hits: stays in the cache.
FIRST_CAPACITY = 1 << 14

#: Bytes of a thread's calls besides: Python's objects, and the splits of the rays of a call.
_CALL_BYTES = 1 << 16


class HitRows(NamedTuple):
    """Buffers for `RayQueries.collect_hits`, made for a number of hits."""

    hits: HitArrays
    capacity: int

    @classmethod
    def of(cls, kind: type[np.floating[Any]], capacity: int) -> HitRows:
        """Allocate `capacity` hits, with distances of a type."""
        return cls(allocate_hits(capacity, kind), capacity)


class Branching(Backend):
    """Traces rays with a structure's own kernels.

    Batches are traced by the structure's many-ray kernels if those suit them; otherwise, and if
    the query counts, ray by ray.

    Parameters
    ----------
    structure : Structure
    """

    capabilities = Capabilities(points=True)

    def __init__(self, structure: Structure) -> None:
        self.structure = structure

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query; see `Backend.run`.

        Notes
        -----
        Without counters, all hits are found in one search, in buffers that grow and that take up
        to twice the memory of the hits.
        """
        if query.kind is not Kind.MULTI_HIT:
            counts = sink.tallies is not None
            if counts or not trace_batch(self.structure, query, rays, sink, progress):
                self.trace_singly(query, rays, sink, progress)
        elif sink.tallies is not None or query.limit == 0:
            fill = partial(self.trace_singly, query, rays)
            self.count_then_fill(query, rays, sink, progress, fill)
        elif sink.visitor is not None:
            self._visit(query, rays, sink, progress)
        else:
            hits = HitAccumulator(len(rays), self.structure.triangles.number_type)
            self._visit(query, rays, Sink(sink.status, visitor=hits.take), progress)
            sink.put(*hits.whole())

    def working_bytes(self, kind: Kind, ray_count: int, hit_count: int) -> int:
        """See `Backend.working_bytes`.

        Notes
        -----
        All hits are collected in buffers, one for each thread, and copied: `HitAccumulator`.
        """
        small = thread_count() * _CALL_BYTES + self.structure.ray_batch.copied_bytes * ray_count
        hit_bytes = HitArrays.row_bytes(self.structure.triangles.number_type)
        if kind is not Kind.MULTI_HIT:
            return small + batch_bytes(self.structure, kind, ray_count)
        capacity = max(FIRST_CAPACITY, 4 * -(-hit_count // max(ray_count, 1)))
        buffers = thread_count() * hit_bytes * capacity
        return small + buffers + 24 * ray_count + hit_bytes * hit_count

    def caster(self) -> Callable[..., Any]:
        """The structure's search of one ray; see `Backend.caster`."""
        structure = self.structure
        return partial(structure.queries.cast, structure.frame, structure.view)

    def run_program(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> bool:
        """Run a query for first or any hits with its filter, which the traversals call.

        Notes
        -----
        A traversal finds hits in any order. So that errors do not depend on it, a query whose
        filter raises is run again, over the nearest hits of each ray.
        """
        if query.kind is not Kind.FIRST_HIT and query.kind is not Kind.ANY_HIT:
            return False
        filter_: Any = query.on_hit
        at_hits = filter_.at_hits(rays)
        progress = rising(progress)
        self.run(query._replace(on_hit=at_hits.addresses), rays, sink, progress)
        if at_hits.has_raised:
            first = query._replace(kind=Kind.FIRST_HIT)
            is_first = query.kind is Kind.FIRST_HIT
            found = sink if is_first else Sink.of(first, len(rays), status=sink.status)
            run_on_hits(self.run, first, rays, found, self.structure.triangles, progress)
            if not is_first:
                # The nearest hit that exists says whether there is one.
                sink.seen = found.hits.prim_id >= 0
        return True

    def trace_singly(
        self,
        query: Query,
        rays: RayBatch,
        sink: Sink,
        progress: Progress | None = None,
        frame: SceneFrame | None = None,
    ) -> None:
        """Run a query ray by ray.

        Parameters
        ----------
        query : Query
        rays : RayBatch
        sink : Sink
            Of `Kind.MULTI_HIT` with `splits` and `hits`: the nearest splits[i + 1] - splits[i] hits
            of each ray i are written, and it must have that many.
        progress : callable, optional
            Called with (rays done, rays).
        frame : SceneFrame, optional
            The rays' frame [default: the scene's].
        """
        structure = self.structure
        scene, kept = self._scene_of(query, rays, sink, frame)
        kernel, out = structure.queries.loops[query.kind], output_of(query, sink)
        most = structure.rays_per_call()
        run_calls((kernel, (scene, out)), (0, len(rays)), structure.least_rays, most, progress)
        del kept  # the kernel reads it by address

    def _scene_of(
        self, query: Query, rays: RayBatch, sink: Sink, frame: SceneFrame | None = None
    ) -> tuple[RayScene, object]:
        """The arguments that rays share, and the objects to keep alive until they are traced."""
        structure, tallies = self.structure, sink.tallies
        has_filter = query.kind is Kind.FIRST_HIT or query.kind is Kind.ANY_HIT
        source, kept = RaySource.of(rays.origins, rays.directions, rays.exact_limits)
        scene = RayScene(
            source,
            structure.frame if frame is None else frame,
            structure.view_for(query, rays, sink),
            np.uint64(array_address(sink.status)),
            None if tallies is None else np.uint64(array_address(tallies)),
            query.on_hit if has_filter else None,
        )
        return scene, kept

    def find_nearest(
        self, batch: PointBatch, out: NearestArrays, progress: Progress | None = None
    ) -> None:
        """Find the triangles nearest to points; see `Backend.find_nearest`."""
        structure, (points, limits, capacity) = self.structure, batch
        kernel, to = form_of(structure.name, "nearest"), NearestArrays(*array_places(*out))
        at, far = array_places(points, limits)
        step, own = step_of(limits), (structure.frame, structure.view)
        scene = PointScene(at, far, step, *own, np.uint64(capacity), NULL, None)
        per_call, least = structure.rays_per_call(), structure.least_rays
        # Fewer than the default: the structure is slow, and a point takes longer than a ray.
        most = POINTS_PER_CALL if per_call >= RAYS_PER_CALL else max(per_call // 8, 1)
        memory_bytes = work_bytes(min(len(points), most), capacity)

        def find(begin: int, end: int, memory: int) -> None:
            kernel(begin, end, scene.in_call(begin, end, memory), to)

        items = 0, len(points)
        run_calls((find, ()), items, least, most, progress, memory_bytes=memory_bytes)

    def _visit(self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None) -> None:
        """Pass all hits to the sink's visitor."""
        structure, visitor = self.structure, sink.visitor
        kind = structure.triangles.number_type
        if trace_batch(structure, query, rays, sink, progress):
            return
        assert visitor is not None
        scene, kept = self._scene_of(query, rays, sink)
        limits = HitLimits(query.surfaces, np.uint64(query.limit), query.is_ordered)

        def fill(begin: int, end: int, rows: HitRows) -> int:
            splits = np.empty(end - begin + 1, np.int64)
            reached = structure.queries.collect_hits(begin, end, scene, limits, splits, rows.hits)
            if reached > begin:
                visitor(HitBatch(rows.hits, splits[: reached - begin + 1], None, begin))
            return int(reached)

        body = GrowingBuffers(partial(HitRows.of, kind), fill, FIRST_CAPACITY)
        calls, most = (body, ()), structure.rays_per_call()
        run_calls(calls, (0, len(rays)), structure.least_rays, most, progress)
        del kept
