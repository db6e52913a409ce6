"""The results of queries: in the rays' shape, hits with their triangles and instances."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.core.hits import Hits, MultiHits
from raystream.geometry.instances import hit_ids
from raystream.kernels.hits import Sink


def _split(numbers: Any, triangles: Any) -> tuple[Any, Any]:
    """The prim_ids and instance_ids (None without instances) of kernels' numbers."""
    if triangles.instances is None:
        return triangles.split_ids(numbers)
    return hit_ids.split_numbers(triangles, numbers)


def _nearest_hits(sink: Sink, shape: tuple[int, ...], triangles: Any) -> Hits:
    t, u, v, numbers = sink.hits
    prim_id, instance_id = _split(numbers, triangles)
    hits = Hits(t, u, v, prim_id, sink.status, triangles, sink.sectors, instance_id)
    return hits if len(shape) == 1 else hits._changed(lambda column: column.reshape(shape))


def _all_hits(sink: Sink, shape: tuple[int, ...], triangles: Any) -> MultiHits:
    t, u, v, numbers = sink.hits
    prim_id, instance_id = _split(numbers, triangles)
    status = sink.status.reshape(shape)
    return MultiHits(sink.splits, t, u, v, prim_id, status, triangles, instance_id)


#: Makes the result of each kind of query, by its number, from what kernels wrote, the rays' leading
#: shape and the scene's triangles.
RESULTS: tuple[Callable[[Sink, tuple[int, ...], Any], Any], ...] = (
    _nearest_hits,
    lambda sink, shape, _: sink.seen.reshape(shape),
    lambda sink, shape, _: sink.counts.reshape(shape),
    _all_hits,
)
