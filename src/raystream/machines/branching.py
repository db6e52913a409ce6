"""The branching machine on the CPU: each ray from start to end, rays shared among the threads."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.collect import HitArrays
from raystream.kernels.growing import Gatherer
from raystream.kernels.hit_batch import HitAccumulator, HitBatch, allocate_hits
from raystream.kernels.queries import Wanted
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.kernels.sink import Sink
from raystream.machines.backend import Backend
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


class Branching(Backend):
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
        if query.kind is not Kind.MULTI_HIT:
            counts = sink.tallies is not None
            if counts or not self.structure.trace_batch(query, rays, sink, progress):
                self.trace_singly(query, rays, sink, progress)
        elif sink.tallies is not None or query.limit == 0:
            filled, half = self.room_for_hits(query, rays, sink, progress)
            self.trace_singly(query, rays, filled, half)
            sink.put(filled.splits, filled.hits)
        elif sink.visitor is not None:
            self._visit(query, rays, sink, progress)
        else:
            hits = HitAccumulator(len(rays))
            self._visit(query, rays, Sink(sink.status, visitor=hits.take), progress)
            sink.put(*hits.whole())

    def trace_singly(
        self,
        query: Query,
        rays: RayBatch,
        sink: Sink,
        progress: Progress | None = None,
        frame: SceneFrame | None = None,
    ) -> None:
        """Answer a query ray by ray.

        Parameters
        ----------
        query : Query
        rays : RayBatch
        sink : Sink
            Of `Kind.MULTI_HIT` with `splits` and `hits`: of each ray i the nearest
            splits[i + 1] - splits[i] hits, of which it has as many, are written.
        progress : callable, optional
            Called with (rays done, rays).
        frame : SceneFrame, optional
            Of the rays [default: the scene's].
        """
        structure = self.structure
        source, kept = RaySource.of(rays.origins, rays.directions, rays.limits)
        kernel, output = structure.queries[query.kind], self._output(query, sink)
        shared = source, structure.frame if frame is None else frame, structure.arrays, sink.tallies

        def body(begin: int, end: int) -> None:
            kernel(begin, end, *shared, *output)

        parallel_for(body, len(rays), self._chunk(len(rays)), progress)
        del kept  # the kernel reads it by address

    def _output(self, query: Query, sink: Sink) -> tuple[Any, ...]:
        """The arguments of `RayQueries` that say what is wanted, and where it goes."""
        if query.kind is Kind.FIRST_HIT:
            return (ResultAddresses.of_first(sink.memory, sink.status),)
        if query.kind is Kind.ANY_HIT:
            return (ResultAddresses.of_any(sink.seen, sink.status),)
        wanted = self._wanted(query)
        if query.kind is Kind.COUNT_HITS:
            return np.uint64(sink.status.ctypes.data), wanted, sink.counts
        return wanted, sink.splits, sink.hits

    def _wanted(self, query: Query) -> Wanted:
        limit = np.uint64(query.limit)
        return Wanted(self.structure.has_duplicates, query.surfaces, limit, query.is_ordered)

    def _visit(self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None) -> None:
        """Give all hits to the sink's visitor."""
        structure, visitor = self.structure, sink.visitor
        if structure.trace_batch(query, rays, sink, progress):
            return
        assert visitor is not None
        source, kept = RaySource.of(rays.origins, rays.directions, rays.limits)
        shared = source, structure.frame, structure.arrays, np.uint64(sink.status.ctypes.data)
        wanted = self._wanted(query)

        def fill(begin: int, end: int, rows: HitRows) -> int:
            splits = np.empty(end - begin + 1, np.int64)
            reached = structure.queries.gather(begin, end, *shared, wanted, splits, rows.hits)
            if reached > begin:
                visitor(HitBatch(rows.hits, splits[: reached - begin + 1], None, begin))
            return int(reached)

        body = Gatherer(HitRows.of, fill, FIRST_CAPACITY)
        parallel_for(body, len(rays), self._chunk(len(rays)), progress)
        del kept

    def _chunk(self, count: int) -> int:
        """Rays that a call of a kernel gets."""
        # A batch is split among the threads even when it is smaller than a call could take,
        # but not so far that the hand-over costs more than the rays.
        share = max(256, -(-count // (4 * thread_count())))
        return min(self.structure.rays_per_call(), share)
