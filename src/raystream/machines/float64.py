"""Float64Backend: runs the queries of tracers with ``precision="float64"``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.query import UNLIMITED, Kind, Query
from raystream.core.rays import RayBatch, as_real_array
from raystream.float64.packets import trace_float64_packets
from raystream.float64.queries import Float64Rows, Float64Source
from raystream.float64.stream import BLOCK_RAYS, WORKING_BYTES, trace_float64_groups
from raystream.float64.structure import Float64Structure
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.hits import Sink
from raystream.kernels.ray_source import RaySource
from raystream.machines.backend import Backend
from raystream.structures.bvh.coherence import choose_kernel, probe
from raystream.structures.bvh.image_rows import LEAST_RAYS, BatchOrder, find_order
from raystream.structures.bvh.packet_rays import PACKET_RAYS, PacketOrder

__all__ = ["Float64Backend", "Float64Rays"]

#: Smaller batches are traced ray by ray.
_FEW = 256

#: Most packets of a call.
_MOST_PACKETS = 64

#: Hits that are sorted at a time, about, and bytes of a hit with what sorting needs.
_HITS = 1 << 20
_HIT_BYTES = 80


class Float64Rays(RayBatch):
    """Rays with limits in float64.

    Attributes
    ----------
    limits : tuple of two ndarray, float32
        Rounded outward.
    float64_limits : tuple of two ndarray of shape (N,) or (1,), float64
    """

    def __init__(self, origins: Any, directions: Any, t_min: Any, t_max: Any) -> None:
        low, high = _number("t_min", t_min), _number("t_max", t_max)
        super().__init__(origins, directions, _rounded(low, -np.inf), _rounded(high, np.inf))
        self.float64_limits = self._spread(low), self._spread(high)

    def _spread(self, limit: NDArray[np.float64]) -> NDArray[np.float64]:
        if limit.ndim == 0:
            return limit.reshape(1)
        return np.ascontiguousarray(np.broadcast_to(limit, self.shape).reshape(-1))


def _number(name: str, values: Any) -> NDArray[np.float64]:
    return as_real_array(name, values).astype(np.float64)


def _rounded(limit: NDArray[np.float64], toward: float) -> Any:
    with np.errstate(over="ignore"):
        near = limit.astype(np.float32)
    is_short = near > limit if toward < 0.0 else near < limit
    return np.where(is_short, np.nextafter(near, np.float32(toward)), near)


class Float64Backend(Backend):
    """Traces in float64 on the CPU, rays divided among threads.

    Parameters
    ----------
    structure : Float64Structure
    """

    structure: Float64Structure

    def __init__(self, structure: Float64Structure) -> None:
        self.structure = structure

    def batch(self, origins: Any, directions: Any, t_min: Any, t_max: Any) -> RayBatch:
        """See `Backend.batch`."""
        return Float64Rays(origins, directions, t_min, t_max)

    def working_bytes(self, kind: Kind, ray_count: int, hit_count: int) -> int:
        """See `Backend.working_bytes`."""
        limits = 8 * ray_count
        if kind is Kind.MULTI_HIT:
            return limits + 16 * ray_count + _HIT_BYTES * hit_count
        return limits + (thread_count() * WORKING_BYTES if ray_count > _FEW else 0)

    def answer(
        self,
        query: Query,
        rays: RayBatch,
        progress: Progress | None = None,
        records: Any = None,
    ) -> Sink:
        """Run a query; see `Backend.answer`. The sink's numbers are float64."""
        del records
        count = len(rays)
        sink = Sink(np.zeros(count, np.uint8))
        if query.kind is Kind.MULTI_HIT:
            self._find_all(query, rays, sink, progress)
            return sink
        self.run(query, rays, sink, progress)
        return sink

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query of one result per ray; see `Backend.run`."""
        loops, count = self.structure.loops, len(rays)
        target: Any = sink
        if query.kind is Kind.FIRST_HIT:
            target.hits = rows = Float64Rows.empty(count)
            if self._kernel(count) != "single":
                self._trace_many(rays, sink.status, False, rows, progress)
            else:
                self._loop(loops.first_hit, rays, sink.status, (rows,), progress)
        elif query.kind is Kind.ANY_HIT:
            sink.seen = np.empty(count, np.bool_)
            if self._kernel(count) != "single":
                rows = Float64Rows.empty(0)._replace(prim_id=sink.seen.view(np.int8))
                self._trace_many(rays, sink.status, True, rows, progress)
            else:
                self._loop(loops.any_hit, rays, sink.status, (sink.seen,), progress)
        else:
            sink.counts = np.empty(count, np.int64)
            output = query.surfaces, sink.counts
            self._loop(loops.count_hits, rays, sink.status, output, progress)

    def _kernel(self, count: int) -> str:
        """The kernel that traces this number of rays; "auto" if that depends on the rays."""
        options: Any = self.structure.options
        if len(self.structure.memory["nodes"]) == 0 or count == 0:
            return "single"
        if options.kernel == "auto" and count <= _FEW:
            return "single"
        return str(options.kernel)

    def _source(self, rays: Any, packed: bool = False) -> tuple[Float64Source, object]:
        source, kept = RaySource.of(rays.origins, rays.directions, rays.limits, packed)
        return Float64Source(source, *rays.float64_limits), kept

    def _loop(
        self,
        kernel: Any,
        rays: RayBatch,
        status: NDArray[np.uint8],
        output: tuple[Any, ...],
        progress: Progress | None,
    ) -> None:
        """Run a loop over rays on all threads."""
        source, kept = self._source(rays)
        shared = source, self.structure.frame, self.structure.arrays, status

        def body(begin: int, end: int) -> None:
            kernel(begin, end, *shared, *output)

        parallel_for(body, len(rays), self._chunk(len(rays)), progress)
        del kept  # the kernel reads it by address

    def _chunk(self, count: int) -> int:
        share = max(64, -(-count // (4 * thread_count())))
        return min(self.structure.rays_per_call(), share)

    def _trace_many(
        self,
        rays: RayBatch,
        status: NDArray[np.uint8],
        wants_any: bool,
        rows: Float64Rows,
        progress: Progress | None,
    ) -> None:
        """Trace packets, or streams of groups, on all threads."""
        source, kept = self._source(rays, True)
        order, count, frame = PacketOrder.of(rays.shape), len(rays), self.structure.frame
        name, tiles = self._kernel(count), BatchOrder(order)
        if name == "auto":
            size = sum(array.nbytes for array in self.structure.memory.values()) // 2
            found = probe(source.rays, order, frame, size)
            name = choose_kernel(found, count, size)
        kernel, per_call = trace_float64_groups, BLOCK_RAYS // PACKET_RAYS
        if name == "packet":
            kernel, per_call = trace_float64_packets, _MOST_PACKETS
            if order.width == 0 and count >= LEAST_RAYS:
                tiles = find_order(source.rays, count, frame)
        packets = tiles.packets.packet_count
        shared = self.structure.arrays, frame, source, tiles.packets, wants_any

        def body(begin: int, end: int) -> None:
            kernel(begin, end, *shared, status, rows)

        def report(done: int, _: int) -> object:
            assert progress is not None
            return progress(done * count // max(packets, 1), count)

        share = max(1, -(-packets // (4 * thread_count())))
        shown = None if progress is None else report
        parallel_for(body, packets, min(per_call, share), shown)
        del kept, tiles

    def _find_all(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None
    ) -> None:
        """Count the hits of all rays, then find and sort those of some rays at a time."""
        count = len(rays)
        counts = np.zeros(count, np.int64)
        half = None if progress is None else lambda done, _: progress(done, 2 * count)
        if query.limit:
            output = query.surfaces, counts
            self._loop(self.structure.loops.count_hits, rays, sink.status, output, half)
        else:
            self.run(Query(Kind.ANY_HIT), rays, sink, half)  # it finds the invalid rays
        splits = np.zeros(count + 1, np.int64)
        np.cumsum(np.minimum(counts, query.limit), out=splits[1:])
        total = int(splits[-1])
        check_memory(
            _HIT_BYTES * total, f"{total:,} hits would", "give max_hits, or trace fewer rays"
        )
        target: Any = sink
        target.splits, target.hits = splits, Float64Rows.empty(total)
        first = 0
        ends = np.cumsum(counts)
        while first < count and total:
            before = ends[first] - counts[first]
            last = max(int(np.searchsorted(ends, before + _HITS, "right")), first + 1)
            part = slice(first, last)
            found = self._found(query, rays, sink.status, counts[part], part)
            rows = slice(splits[first], splits[last])
            for column, values in zip(target.hits, found, strict=True):
                column[rows] = values
            first = last
            if progress:
                progress(count + first, 2 * count)

    def _found(
        self,
        query: Query,
        rays: RayBatch,
        status: NDArray[np.uint8],
        counts: NDArray[np.int64],
        part: slice,
    ) -> tuple[NDArray[Any], ...]:
        """The hits of some rays by t, then prim_id, up to the limit; `counts` are their numbers."""
        splits = np.zeros(len(counts) + 1, np.int64)
        np.cumsum(counts, out=splits[1:])
        rows = Float64Rows.empty(int(splits[-1]))
        source, kept = self._source(rays)
        first, last, loop = part.start, part.stop, self.structure.loops.multi_hit
        shared = source, self.structure.frame, self.structure.arrays
        output = query.surfaces, np.int64(first), splits, rows

        def body(begin: int, end: int) -> None:
            loop(first + begin, first + end, *shared, status, *output)

        parallel_for(body, last - first, self._chunk(last - first))
        del kept
        ray_id = np.repeat(np.arange(len(counts)), counts)
        order = np.lexsort((rows.prim_id, rows.t, ray_id))
        if query.limit != UNLIMITED:
            rank = np.arange(len(order)) - np.repeat(splits[:-1], counts)
            order = order[rank < query.limit]
        return tuple(column[order] for column in rows)
