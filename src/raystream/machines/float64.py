"""Float64Backend: runs the queries of tracers with ``precision="float64"``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch, as_real_array
from raystream.float64.packets import trace_float64_packets
from raystream.float64.queries import Float64Source
from raystream.float64.stream import BLOCK_RAYS, WORKING_BYTES, trace_float64_groups
from raystream.float64.structure import Float64Structure
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.hits import HitArrays, Sink
from raystream.kernels.ray_source import RaySource
from raystream.machines.backend import Backend
from raystream.structures.bvh.coherence import choose_kernel, probe
from raystream.structures.bvh.image_rows import LEAST_RAYS, BatchOrder, find_order
from raystream.structures.bvh.packet_rays import PACKET_RAYS, PacketOrder

#: Smaller batches are traced ray by ray.
_FEW = 256

#: Most packets of a call.
_MOST_PACKETS = 64


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
        del hit_count
        limits = 8 * ray_count
        if kind is Kind.MULTI_HIT:
            return limits + 16 * ray_count  # see `room_for_hits`
        return limits + (thread_count() * WORKING_BYTES if ray_count > _FEW else 0)

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query; see `Backend.run`."""
        loops, count = self.structure.loops, len(rays)
        if query.kind is Kind.FIRST_HIT:
            if self._kernel(count) != "single":
                self._trace_many(rays, sink.status, False, sink.hits, progress)
            else:
                self._loop(loops.first_hit, rays, sink.status, (sink.hits,), progress)
        elif query.kind is Kind.ANY_HIT:
            if self._kernel(count) != "single":
                none: Any = HitArrays.empty(0, np.float64)
                rows = none._replace(prim_id=sink.seen.view(np.int8))
                self._trace_many(rays, sink.status, True, rows, progress)
            else:
                self._loop(loops.any_hit, rays, sink.status, (sink.seen,), progress)
        elif query.kind is Kind.COUNT_HITS:
            output = query.surfaces, np.uint64(query.limit), sink.counts
            self._loop(loops.count_hits, rays, sink.status, output, progress)
        else:
            filled, half = self.room_for_hits(query, rays, sink, progress)
            found = query.surfaces, filled.splits, filled.hits
            self._loop(loops.multi_hit, rays, sink.status, found, half)
            sink.put(filled.splits, filled.hits)

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
        rows: HitArrays,
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
