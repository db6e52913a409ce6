"""Masks as a filter, for machines whose traversals do not ask for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.errors import RaystreamError
from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.core.store import Store
from raystream.kernels.masks import MaskTable, is_admitted
from raystream.programs.filters import Bound, Filter


def _may_hit(hit: Any, masks: Any) -> Any:
    return is_admitted(masks[0], np.uint64(hit.ray), hit.prim_id)


def with_masks(query: Query, rays: RayBatch, triangles: Store) -> Query:
    """The same query with the masks of rays as its filter; itself if they may hit everything.

    Raises
    ------
    RaystreamError
        If it has a filter or program of its own, or counts.
    """
    masks, runs, given = rays.masks, triangles.mask_runs, query.on_hit
    if masks is None or runs.admit(masks) or getattr(given, "function", None) is _may_hit:
        return query
    if given is not None or query.counters:
        raise RaystreamError(
            "mask: not supported together with on_hit, skip_prim_ids or counters=True where "
            "machine='multipass'; use machine='branching'"
        )
    table = MaskTable.of(masks, runs)
    bound = Bound(_may_hit, (table.address,), table)
    return query._replace(on_hit=Filter.of(bound, None, triangles))
