"""The kernels that answer rays and points one by one, of every structure."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.core.query import Kind
from raystream.jit.constants import NULL
from raystream.kernels.aligned import array_address, array_places
from raystream.kernels.growing_buffers import GrowingBuffers
from raystream.kernels.hits import HitArrays, HitBatch, allocate_hits
from raystream.kernels.point_queries import (
    POINTS_PER_CALL,
    NearestArrays,
    PointBatch,
    PointScene,
    step_of,
    work_bytes,
)
from raystream.kernels.queries import HitLimits, RayScene, output_of
from raystream.structures.batch_kernels import (
    SINGLE,
    Batch,
    BatchKernel,
    BatchKernels,
    Calls,
    CallSize,
)

if TYPE_CHECKING:
    from raystream.structures.base import Structure

#: Initial capacity in hits: stays in the cache.
FIRST_CAPACITY = 1 << 14

#: Most rays per call of a compiled loop: enough to amortise the call (about 20 microseconds), few
#: enough to balance the threads and to notice Ctrl-C.
RAYS_PER_CALL = 4096

#: Calls of each thread.
_SHARE = 4


def with_single(structure: Structure) -> dict[Kind, BatchKernels]:
    """The kernels of a structure by the kind of query, with those that trace rays one by one."""
    most = structure.rays_per_call
    size = CallSize(min(structure.least_rays, most), most, share=_SHARE, joins_chunks=False)
    single = {SINGLE: BatchKernel(_trace_singly, size, by_packets=False)}
    nothing = BatchKernels({})
    known = {
        kind: structure.many_ray_kernels.get(kind, nothing) for kind in list(Kind)[: Kind.TRACE]
    }
    return {kind: one._replace(kernels={**one.kernels, **single}) for kind, one in known.items()}


def _trace_singly(structure: Structure, batch: Batch) -> Calls:
    """Answer rays by the query's loop, or deliver all hits to the sink's visitor.

    Of `Kind.MULTI_HIT` without a visitor, the sink has `splits` and `hits`: the nearest
    splits[i + 1] - splits[i] hits of each ray i are written, and it must have that many.
    """
    query, sink, tallies = batch.query, batch.sink, batch.sink.tallies
    scene = RayScene(
        batch.source,
        structure.frame,
        structure.view_for(query, batch.rays, sink),
        np.uint64(array_address(sink.status)),
        None if tallies is None else np.uint64(array_address(tallies)),
        query.on_hit,
    )
    if sink.visitor is None:
        return structure.queries.loops[query.kind], (scene, output_of(query, sink))
    visitor = sink.visitor
    limits = HitLimits(query.surfaces, np.uint64(query.limit), query.is_ordered)

    def fill(begin: int, end: int, rows: HitArrays) -> int:
        splits = np.empty(end - begin + 1, np.int64)
        reached = structure.queries.collect_hits(begin, end, scene, limits, splits, rows)
        if reached > begin:
            visitor(HitBatch(rows, splits[: reached - begin + 1], None, begin))
        return int(reached)

    rows_of = partial(allocate_hits, kind=structure.triangles.number_type)
    return GrowingBuffers(rows_of, fill, FIRST_CAPACITY), ()


def nearest_calls(
    structure: Structure, batch: PointBatch, out: NearestArrays
) -> tuple[Calls, CallSize]:
    """The calls that find the triangles nearest to points, and their size."""
    points, limits, capacity = batch
    kernel: Any = structure.point_loop
    to = NearestArrays(*array_places(*out))
    at, far = array_places(points, limits)
    step, own = step_of(limits), (structure.frame, structure.point_view)
    scene = PointScene(at, far, step, *own, np.uint64(capacity), NULL, None)
    per_call = structure.rays_per_call
    # Fewer than the default: the structure is slow, and a point takes longer than a ray.
    most = POINTS_PER_CALL if per_call >= RAYS_PER_CALL else max(per_call // 8, 1)
    least = min(structure.least_rays, most)
    memory_bytes = work_bytes(min(len(points), most), capacity)

    def find(begin: int, end: int, memory: int) -> None:
        kernel(begin, end, scene.in_call(begin, end, memory), to)

    return (find, ()), CallSize(least, most, 1, _SHARE, memory_bytes, joins_chunks=False)
