"""QueryInputs a tracer about a block of rays."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, part_of
from raystream.tracer import Tracer
from raystream.zarr_queries.blocks import Block

__all__ = ["Answer", "QueryInputs"]

#: Hits of a part of a block that are held at a time, for each ray of a block.
HITS_A_RAY = 16


class Answer(NamedTuple):
    """What was found for a block, or for a part of one.

    Attributes
    ----------
    block : Block
    arrays : dict of str to ndarray
        In the rays' shape; for the last part of a block, and for no other.
    rows : MultiHits or None
        Hits of the rays that follow those of the part before.
    rays_hit, hits, invalid_rays : int
    """

    block: Block
    arrays: dict[str, NDArray[Any]]
    rows: MultiHits | None
    rays_hit: int
    hits: int
    invalid_rays: int


class QueryInputs:
    """Asks one query of a tracer.

    Parameters
    ----------
    tracer : Tracer
    query : {"first_hit", "any_hit", "multi_hit", "count_hits"}
    options : dict
        Of the query: ``max_hits``, ``crossings``.
    """

    def __init__(self, tracer: Tracer, query: str, options: dict[str, Any]) -> None:
        self._tracer = tracer
        self._query = query
        self._options = {name: value for name, value in options.items() if name != "max_hits"}
        self._max_hits: int | None = options.get("max_hits")
        self._part = 0  # rays of a part that went well

    def __call__(
        self, block: Block, rays: dict[str, NDArray[Any]], progress: Progress | None
    ) -> Iterator[Answer]:
        """Answer for a block, in parts.

        Parameters
        ----------
        block : Block
        rays : dict of str to ndarray
            Arguments of the query.
        progress : callable or None
            Called with (rays done, rays of the block).

        Yields
        ------
        Answer
        """
        if self._query == "multi_hit":
            yield from self._all_hits(block, rays, progress)
            return
        found: Any = getattr(self._tracer, self._query)(**rays, **self._options, progress=progress)
        if self._query == "first_hit":
            names = ("t", "u", "v", "prim_id", "mesh_id", "status")
            arrays = {name: getattr(found, name) for name in names}
            rays_hit = int(np.count_nonzero(found.is_hit))
            yield Answer(
                block, arrays, None, rays_hit, rays_hit, int(np.count_nonzero(found.status))
            )
        else:
            name = "hit" if self._query == "any_hit" else "count"
            rays_hit = int(np.count_nonzero(found))
            yield Answer(block, {name: found}, None, rays_hit, int(found.sum()), 0)

    def _all_hits(
        self, block: Block, rays: dict[str, NDArray[Any]], progress: Progress | None
    ) -> Iterator[Answer]:
        """All hits, in parts that have few enough to be held.

        How many there are is not known before. A part is asked for no more hits of a ray than
        there is room for, were all rays to have as many; if one of them may have more, the part
        is halved. What is found then is all there is, without a count before.
        """
        batch = RayBatch(**rays)
        count = len(batch)
        room = HITS_A_RAY * count
        status = np.empty(count, np.uint8)
        begin, part = 0, self._part or count
        while begin < count:
            end = min(begin + part, count)
            limit = room // (end - begin)
            wanted = self._max_hits
            is_bounded = (wanted is not None and wanted <= limit) or end - begin == 1
            hits = self._tracer.multi_hit(
                batch.origins[begin:end],
                batch.directions[begin:end],
                t_min=batch.t_min[begin:end],
                t_max=batch.t_max[begin:end],
                max_hits=wanted if is_bounded else limit,
                **self._options,
                progress=_rays_of(progress, begin, end - begin, count),
            )
            most = int(hits.counts.max())
            if not is_bounded and most >= limit:
                part = (end - begin + 1) // 2
                continue
            status[begin:end] = hits.status
            arrays = {"status": status} if end == count else {}
            yield Answer(
                block,
                arrays,
                hits,
                int(np.count_nonzero(hits.counts)),
                len(hits.t),
                int(np.count_nonzero(hits.status)),
            )
            begin = end
            if most < limit // 4:
                part *= 2
        self._part = min(part, count)


def _rays_of(progress: Progress | None, begin: int, count: int, total: int) -> Progress | None:
    """Of steps, of which a ray may take two, make rays."""
    if progress is None:
        return None
    shown = part_of(progress, begin, total)
    assert shown is not None
    return lambda done, steps: shown(count * done // max(steps, 1), total)
