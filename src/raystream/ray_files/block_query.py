"""Run a tracer's query on a block of rays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import MultiHits
from raystream.jit.threads import Progress, part_of
from raystream.ray_files.blocks import Block
from raystream.tracer import Tracer

#: Maximum hits of a part of a block held in memory, per ray of a block.
HITS_PER_RAY = 16


class BlockResult(NamedTuple):
    """Hits of a block, or of a part of one.

    Attributes
    ----------
    block : Block
    arrays : dict of str to ndarray
        Arrays of the rays' shape; empty except in the last part of a block.
    rows : MultiHits or None
        Hits of the rays following those of the previous part.
    rays_hit, hits, invalid_rays : int
    """

    block: Block
    arrays: dict[str, NDArray[Any]]
    rows: MultiHits | None
    rays_hit: int
    hits: int
    invalid_rays: int


class BlockQuery:
    """Runs one query on a tracer, block by block.

    Parameters
    ----------
    tracer : Tracer
    query : {"first_hit", "any_hit", "multi_hit", "count_hits"}
    options : dict
        Options of the query: ``max_hits``, ``crossings``.
    names : sequence of str
        Columns of the rays' shape.
    """

    def __init__(
        self, tracer: Tracer, query: str, options: dict[str, Any], names: Sequence[str]
    ) -> None:
        self._tracer = tracer
        self._query, self._names = query, names
        self._options = {name: value for name, value in options.items() if name != "max_hits"}
        self._max_hits: int | None = options.get("max_hits")
        self._part = 0  # part size that worked for the previous block

    def __call__(
        self, block: Block, rays: dict[str, NDArray[Any]], progress: Progress | None
    ) -> Iterator[BlockResult]:
        """Trace a block, yielding its hits in parts.

        Parameters
        ----------
        block : Block
        rays : dict of str to ndarray
            Arguments of the query.
        progress : callable or None
            Called with (rays done, rays of the block).

        Yields
        ------
        BlockResult
        """
        if self._query == "multi_hit":
            yield from self._all_hits(block, rays, progress)
            return
        found: Any = getattr(self._tracer, self._query)(**rays, **self._options, progress=progress)
        if self._query == "first_hit":
            arrays = {name: getattr(found, name) for name in self._names}
            rays_hit = int(np.count_nonzero(found.is_hit))
            yield BlockResult(
                block, arrays, None, rays_hit, rays_hit, int(np.count_nonzero(found.status))
            )
        else:
            name = "hit" if self._query == "any_hit" else "count"
            rays_hit = int(np.count_nonzero(found))
            yield BlockResult(block, {name: found}, None, rays_hit, int(found.sum()), 0)

    def _all_hits(
        self, block: Block, rays: dict[str, NDArray[Any]], progress: Progress | None
    ) -> Iterator[BlockResult]:
        """Find all hits, in parts small enough to hold in memory.

        The number of hits is not known in advance. Each part limits the hits per ray so that
        the result fits even if every ray reaches the limit; if any ray does reach it, the part
        is halved. The result is then complete, without a counting pass.
        """
        batch = self._tracer.structure.ray_batch(**rays)
        count = len(batch)
        room = HITS_PER_RAY * count
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
                progress=part_of(progress, begin, end - begin, count),
            )
            most = int(hits.counts.max())
            if not is_bounded and most >= limit:
                part = (end - begin + 1) // 2
                continue
            status[begin:end] = hits.status
            arrays = {"status": status} if end == count else {}
            yield BlockResult(
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
