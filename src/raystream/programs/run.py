"""Queries with programs or filters, run on the CPU over the hits of any backend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitVisitor, Sink
from raystream.programs.filters import count_filtered, filter_first, multi_filtered
from raystream.programs.trace import trace_program


def run_on_hits(
    run: Callable[..., None],
    query: Query,
    rays: RayBatch,
    sink: Sink,
    triangles: Triangles | InstancedTriangles,
    progress: Progress | None,
) -> None:
    """Answer a query that has a filter or a program.

    Parameters
    ----------
    run : callable
        ``run(query, rays, sink, progress)`` answers queries without either.
    query : Query
    rays : RayBatch
    sink : Sink
    triangles : Triangles or InstancedTriangles
    progress : callable, optional
    """

    def find(
        batch: RayBatch,
        limit: int,
        is_ordered: bool,
        visitor: HitVisitor,
        status: NDArray[np.uint8],
        report: Progress | None,
    ) -> None:
        hits = Query(Kind.MULTI_HIT, query.surfaces, limit, is_ordered)
        run(hits, batch, Sink(status, visitor=visitor), report)

    chosen: Any = query.on_hit
    if query.kind is Kind.FIRST_HIT:
        run(query._replace(on_hit=None), rays, sink, progress)
        filter_first(chosen, find, rays, sink.hits)
    elif query.kind is Kind.COUNT_HITS:
        sink.counts = count_filtered(chosen, find, rays, progress)
    elif query.kind is Kind.MULTI_HIT:
        sink.put(*multi_filtered(chosen, find, rays, query.limit, sink.status, progress))
    else:
        trace_program(find, rays, triangles, chosen, sink.records, query.is_ordered, progress)
