"""The branching machine on the CPU: each ray from start to end, rays divided among threads."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, rising, thread_count
from raystream.kernels.hit_filter import NO_FILTER, masked
from raystream.kernels.hits import HitAccumulator, HitArrays, Sink
from raystream.kernels.masks import MaskTable
from raystream.kernels.point_queries import NearestArrays, PointBatch
from raystream.machines.backend import Backend, Capabilities
from raystream.machines.batch import batch_bytes, run_calls, trace_batch
from raystream.programs.run import run_on_hits
from raystream.structures import Structure
from raystream.structures.single_kernels import FIRST_CAPACITY, nearest_calls

#: Bytes of a thread's calls besides: Python's objects, and the splits of the rays of a call.
_CALL_BYTES = 1 << 16


class Branching(Backend):
    """Traces rays with a structure's own kernels.

    Parameters
    ----------
    structure : Structure
    """

    capabilities = Capabilities(points=True, masks=True)

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
        structure, is_whole = self.structure, query.kind is Kind.MULTI_HIT
        masks, table = rays.masks, None  # the table is kept until all rays are traced
        if masks is not None and not (runs := structure.triangles.mask_runs).admit(masks):
            table = MaskTable.of(masks, runs)
            on_hit = masked(query.on_hit or NO_FILTER, table.address, structure.triangles)
            query = query._replace(on_hit=on_hit)
        if is_whole and (sink.tallies is not None or query.limit == 0):
            fill = partial(trace_batch, structure, query, rays)
            self.count_then_fill(query, rays, sink, progress, fill)
        elif is_whole and sink.visitor is None:
            hits = HitAccumulator(len(rays), structure.triangles.number_type)
            into = Sink(sink.status, visitor=hits.take)
            trace_batch(structure, query, rays, into, progress)
            sink.put(*hits.whole())
        else:
            trace_batch(structure, query, rays, sink, progress)
        structure.raise_faults()

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
        found = partial(structure.queries.cast, structure.frame, structure.view)
        return structure.checked(found)

    def run_program(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> bool:
        """Run a query with its filter, which the traversals call.

        Notes
        -----
        A traversal finds hits in any order. So that errors do not depend on it, a query whose
        filter raises is run again, over the nearest hits of each ray.
        """
        filter_: Any = query.on_hit
        is_one = query.kind is Kind.FIRST_HIT or query.kind is Kind.ANY_HIT
        if not is_one and (query.kind is Kind.TRACE or not filter_.is_bare):
            return False  # the hits before the one that ends a ray depend on the order
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

    def find_nearest(
        self, batch: PointBatch, out: NearestArrays, progress: Progress | None = None
    ) -> None:
        """Find the triangles nearest to points; see `Backend.find_nearest`."""
        calls, size = nearest_calls(self.structure, batch, out)
        run_calls(calls, (0, len(batch.points)), size, progress)
        self.structure.raise_faults()
