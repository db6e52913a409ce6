"""The results of a query in the rays' shape, hits with their triangles and instances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.core.hit_kinds import hits_type, multi_hits_type
from raystream.core.hits import Hits, MultiHits
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.primitives import Primitives
from raystream.core.query import Kind
from raystream.instances import hit_ids
from raystream.kernels.hits import Sink


def split_numbers(numbers: Any, triangles: Any) -> tuple[Any, Any]:
    """The prim_ids and instance_ids (None without instances) of kernels' numbers."""
    if isinstance(triangles, InstancedTriangles):
        return hit_ids.split_numbers(triangles, numbers)
    if isinstance(triangles, Primitives):
        return triangles.prim_ids_of(numbers), None
    return numbers, None


def nearest_hits(sink: Sink, shape: tuple[int, ...], triangles: Any) -> Hits:
    """The results of `Kind.FIRST_HIT` for rays of a leading shape."""
    t, u, v, numbers = sink.hits
    prim_id, instance_id = split_numbers(numbers, triangles)
    columns: Any = t, u, v, prim_id, sink.status, sink.sectors, instance_id
    if len(shape) != 1:
        columns = [None if one is None else one.reshape(shape) for one in columns]
    t, u, v, prim_id, status, *rest = columns
    return hits_type(triangles)(t, u, v, prim_id, status, triangles, *rest)


def all_hits(sink: Sink, shape: tuple[int, ...], triangles: Any) -> MultiHits:
    """The results of `Kind.MULTI_HIT` for rays of a leading shape."""
    t, u, v, numbers = sink.hits
    prim_id, instance_id = split_numbers(numbers, triangles)
    status = sink.status.reshape(shape)
    kind = multi_hits_type(triangles)
    return kind(sink.splits, t, u, v, prim_id, status, triangles, instance_id)


#: The results by the kind of query: ``result(sink, shape, triangles)``.
RESULTS: dict[Kind, Callable[..., Any]] = {
    Kind.FIRST_HIT: nearest_hits,
    Kind.ANY_HIT: lambda sink, shape, _: sink.seen.reshape(shape),
    Kind.COUNT_HITS: lambda sink, shape, _: sink.counts.reshape(shape),
    Kind.MULTI_HIT: all_hits,
}
