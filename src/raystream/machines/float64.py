"""Float64Backend: runs the queries of tracers with ``precision="float64"``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch, as_real_array
from raystream.float64.queries import Float64Source
from raystream.float64.structure import Float64Structure
from raystream.jit.threads import Progress, parallel_for
from raystream.kernels.hits import HitAccumulator, Sink
from raystream.kernels.ray_source import RaySource
from raystream.machines.backend import Backend
from raystream.machines.batch import batch_bytes, call_size, trace_batch

#: Least rays of a call.
_LEAST = 64


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
        return limits + batch_bytes(self.structure, kind, ray_count)

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query; see `Backend.run`."""
        loops = self.structure.loops
        if query.kind is Kind.MULTI_HIT and sink.visitor is None and query.limit > len(rays):
            hits = HitAccumulator(len(rays), np.float64)
            part = Sink(sink.status, visitor=hits.take)
            if trace_batch(self.structure, query, rays, part, progress):
                sink.put(*hits.whole())
                return
        elif trace_batch(self.structure, query, rays, sink, progress):
            return
        if query.kind is Kind.FIRST_HIT:
            self._loop(loops.first_hit, rays, sink.status, (sink.hits,), progress)
        elif query.kind is Kind.ANY_HIT:
            self._loop(loops.any_hit, rays, sink.status, (sink.seen,), progress)
        elif query.kind is Kind.COUNT_HITS:
            output = query.surfaces, np.uint64(query.limit), sink.counts
            self._loop(loops.count_hits, rays, sink.status, output, progress)
        else:
            filled, half = self.room_for_hits(query, rays, sink, progress)
            found = query.surfaces, filled.splits, filled.hits
            self._loop(loops.multi_hit, rays, sink.status, found, half)
            sink.put(filled.splits, filled.hits)

    def _loop(
        self,
        kernel: Any,
        rays: RayBatch,
        status: NDArray[np.uint8],
        output: tuple[Any, ...],
        progress: Progress | None,
    ) -> None:
        """Run a loop over rays on all threads."""
        numbers: Any = rays
        source, kept = RaySource.of(rays.origins, rays.directions, rays.limits)
        shared = (
            Float64Source(source, *numbers.float64_limits),
            self.structure.frame,
            self.structure.arrays,
            status,
        )

        def body(begin: int, end: int) -> None:
            kernel(begin, end, *shared, *output)

        parallel_for(
            body, len(rays), call_size(len(rays), _LEAST, self.structure.rays_per_call()), progress
        )
        del kept  # the kernel reads it by address
