"""The branching machine on the CPU: each ray from start to end, rays shared among the threads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.collect import HitArrays
from raystream.kernels.growing import Gatherer
from raystream.kernels.hit_batch import HitAccumulator, HitBatch, HitVisitor, allocate_hits
from raystream.kernels.queries import LocalRays
from raystream.kernels.sink import Sink
from raystream.machines.local import LocalBackend
from raystream.machines.ray_block import RayBlock, blocks
from raystream.structures import Structure

__all__ = ["Branching"]

#: Hits for which there is room at first: it stays in the cache.
FIRST_CAPACITY = 1 << 14


class HitRows(NamedTuple):
    """Buffers for `RayQueries.gather`."""

    hits: HitArrays
    capacity: int

    @classmethod
    def of(cls, capacity: int) -> HitRows:
        """Room for `capacity` hits."""
        return cls(allocate_hits(capacity), capacity)


class Branching(LocalBackend):
    """Traces rays with a structure's own kernels.

    Batches that the structure's kernels for many rays suit are theirs; others are traced one ray
    after another, and so are those of queries that count.

    Parameters
    ----------
    structure : Structure
    """

    def __init__(self, structure: Structure) -> None:
        self.structure = structure

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query; see `Backend.run`.

        Notes
        -----
        Without counters, all hits are found in one search, in buffers that grow; for a while
        they take twice their memory.
        """
        if sink.tallies is not None or query.limit == 0:
            super().run(query, rays, sink, progress)
        elif query.kind is not Kind.MULTI_HIT:
            if not self.structure.trace_batch(query, rays, sink, progress):
                super().run(query, rays, sink, progress)
        elif sink.visitor is not None:
            self._visit(query, rays, sink, progress)
        else:
            hits = HitAccumulator(len(rays))
            self._visit(query, rays, Sink(sink.status, visitor=hits.take), progress)
            sink.put(*hits.whole())

    def run_local(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query of local rays; see `LocalBackend.run_local`."""
        structure, surfaces = self.structure, query.surfaces
        kernels, repeats = structure.queries, structure.lists_twice
        if query.kind is Kind.FIRST_HIT:
            self._run(kernels.first_hit, (rays, sink.hits, sink.tallies), progress)
        elif query.kind is Kind.ANY_HIT:
            self._run(kernels.any_hit, (rays, sink.seen, sink.tallies), progress)
        elif query.kind is Kind.COUNT_HITS:
            most = query.limit, sink.counts, sink.tallies
            self._run(kernels.count_hits, (rays, repeats, surfaces, *most), progress)
        else:
            to = sink.splits, sink.hits, sink.tallies
            self._run(kernels.multi_hit, (rays, repeats, surfaces, *to), progress)

    def _visit(self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None) -> None:
        """Give all hits to the sink's visitor."""
        if self.structure.trace_batch(query, rays, sink, progress):
            return
        assert sink.visitor is not None
        for block in blocks(rays, self.structure.frame, sink.status, progress):
            self._visit_block(query, block, sink.visitor)

    def _visit_block(self, query: Query, block: RayBlock, visitor: HitVisitor) -> None:
        structure, rays, first = self.structure, block.rays, block.rows.start
        gather = structure.queries.gather
        arguments = structure.arrays, structure.triangles.extreme, rays, block.t_scale
        goal = structure.lists_twice, query.surfaces, query.limit, query.is_ordered

        def fill(begin: int, end: int, rows: HitRows) -> int:
            splits = np.empty(end - begin + 1, np.int64)
            reached = int(gather(begin, end, *arguments, *goal, splits, rows.hits))
            if reached > begin:
                visitor(HitBatch(rows.hits, splits[: reached - begin + 1], None, first + begin))
            return reached

        count = len(rays.t_min)
        body = Gatherer(HitRows.of, fill, FIRST_CAPACITY)
        parallel_for(body, count, self._chunk(count), block.progress)

    def _run(
        self, kernel: Callable[..., None], arguments: tuple[Any, ...], progress: Progress | None
    ) -> None:
        arrays, extreme = self.structure.arrays, self.structure.triangles.extreme

        def body(begin: int, end: int) -> None:
            kernel(begin, end, arrays, extreme, *arguments)

        count = len(arguments[0].t_min)
        parallel_for(body, count, self._chunk(count), progress)

    def _chunk(self, count: int) -> int:
        """Rays that a call of a kernel gets."""
        # A batch is split among the threads even when it is smaller than a call could take,
        # but not so far that the hand-over costs more than the rays.
        share = max(256, -(-count // (4 * thread_count())))
        return min(self.structure.rays_per_call(), share)
