"""The results of a query as `Hits`: in the rays' shape, with their triangles and instances."""

from __future__ import annotations

from typing import Any

from raystream.core.float64_hits import Float64Hits, Float64MultiHits
from raystream.core.float64_triangles import Float64Triangles
from raystream.core.hits import Hits, MultiHits
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.triangles import Triangles
from raystream.kernels.hits import Sink

__all__ = ["all_hits", "nearest_hits"]


def nearest_hits(
    sink: Sink, shape: tuple[int, ...], triangles: Triangles | InstancedTriangles
) -> Hits:
    """The results of `Kind.FIRST_HIT` for rays of a leading shape."""
    t, u, v, prim_id = sink.hits
    status, sectors = sink.status, sink.sectors
    instance_id = None
    kind = Hits
    if isinstance(triangles, InstancedTriangles):
        prim_id, instance_id = triangles.split_ids(prim_id)
    elif isinstance(triangles, Float64Triangles):
        kind = Float64Hits
    if len(shape) == 1:
        return kind(t, u, v, prim_id, status, triangles, sectors, instance_id)
    columns: list[Any] = [
        None if one is None else one.reshape(shape)
        for one in (t, u, v, prim_id, status, sectors, instance_id)
    ]
    t, u, v, prim_id, status, sectors, instance_id = columns
    return kind(t, u, v, prim_id, status, triangles, sectors, instance_id)


def all_hits(
    sink: Sink, shape: tuple[int, ...], triangles: Triangles | InstancedTriangles
) -> MultiHits:
    """The results of `Kind.MULTI_HIT` for rays of a leading shape."""
    t, u, v, prim_id = sink.hits
    instance_id = None
    kind = MultiHits
    if isinstance(triangles, InstancedTriangles):
        prim_id, instance_id = triangles.split_ids(prim_id)
    elif isinstance(triangles, Float64Triangles):
        kind = Float64MultiHits
    status = sink.status.reshape(shape)
    return kind(sink.splits, t, u, v, prim_id, status, triangles, instance_id)
