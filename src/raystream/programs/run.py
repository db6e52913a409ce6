"""Queries with programs or filters, run on the CPU over the hits of any backend."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.store import Store
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitVisitor, Sink
from raystream.programs.filters import count_filtered, filter_first, multi_filtered
from raystream.programs.program import Program
from raystream.programs.ray_subset import RaySubset
from raystream.programs.rounds import visit


def run_on_hits(
    run: Callable[..., None],
    query: Query,
    rays: RayBatch,
    sink: Sink,
    triangles: Store,
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
    triangles : Store
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
        program = Program(chosen, "trace", None, (sink.records,), triangles)
        program.compile()
        whole, status = RaySubset(rays, None, 0), np.zeros(len(rays), np.uint8)
        visit(find, whole, program.run, status, progress, is_ordered=query.is_ordered)
