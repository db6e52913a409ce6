"""The results of a query as `Hits`: in the rays' shape, with their triangles and instances."""

from __future__ import annotations

from typing import Any

from raystream.core.hits import Hits, MultiHits
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.primitive_hits import PrimitiveHits, PrimitiveMultiHits
from raystream.core.primitives import Primitives
from raystream.core.triangles import Triangles
from raystream.kernels.hits import Sink

__all__ = ["all_hits", "nearest_hits"]


def nearest_hits(
    sink: Sink, shape: tuple[int, ...], triangles: Triangles | InstancedTriangles | Primitives
) -> Hits:
    """The results of `Kind.FIRST_HIT` for rays of a leading shape."""
    t, u, v, prim_id = sink.hits
    status, sectors = sink.status, sink.sectors
    instance_id = None
    if isinstance(triangles, InstancedTriangles):
        prim_id, instance_id = triangles.split_ids(prim_id)
    kind: type[Hits] = Hits
    held: Any = triangles
    if isinstance(triangles, Primitives):
        kind, prim_id = PrimitiveHits, triangles.prim_ids_of(prim_id)
    if len(shape) == 1:
        return kind(t, u, v, prim_id, status, held, sectors, instance_id)
    columns: list[Any] = [
        None if one is None else one.reshape(shape)
        for one in (t, u, v, prim_id, status, sectors, instance_id)
    ]
    t, u, v, prim_id, status, sectors, instance_id = columns
    return kind(t, u, v, prim_id, status, held, sectors, instance_id)


def all_hits(
    sink: Sink, shape: tuple[int, ...], triangles: Triangles | InstancedTriangles | Primitives
) -> MultiHits:
    """The results of `Kind.MULTI_HIT` for rays of a leading shape."""
    t, u, v, prim_id = sink.hits
    instance_id = None
    if isinstance(triangles, InstancedTriangles):
        prim_id, instance_id = triangles.split_ids(prim_id)
    status = sink.status.reshape(shape)
    if isinstance(triangles, Primitives):
        prim_id = triangles.prim_ids_of(prim_id)
        held: Any = triangles
        return PrimitiveMultiHits(sink.splits, t, u, v, prim_id, status, held)
    return MultiHits(sink.splits, t, u, v, prim_id, status, triangles, instance_id)
