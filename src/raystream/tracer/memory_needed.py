"""The memory that queries need, known before they run."""

from __future__ import annotations

from typing import Any, NamedTuple

from raystream.core.checks import check_least
from raystream.core.memory import check_memory
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.geometry.instances.hit_ids import split_bytes
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.tracer.ray_cast import RayCaster

#: From this many rays on the free memory is checked, which takes longer than a small query.
CHECKED_RAYS = 1 << 20

#: Bytes of a ray's results, with its status.
_RESULT = {Kind.FIRST_HIT: 17, Kind.ANY_HIT: 2, Kind.COUNT_HITS: 9, Kind.MULTI_HIT: 9}

#: Bytes of a hit of `multi_hit`.
_HIT = 16

#: Bytes of a ray's counters, see `kernels.tally`.
ROW_BYTES = 32

_KINDS = {kind.name.lower(): kind for kind in _RESULT}


class MemoryNeeded(NamedTuple):
    """Memory of a query.

    Attributes
    ----------
    results : int
        Bytes of the arrays that it returns.
    working : int
        Additional bytes that it needs until it returns.
    """

    results: int
    working: int

    @property
    def total(self) -> int:
        """Bytes of both."""
        return self.results + self.working


class MemoryEstimator(RayCaster):
    """Queries of a `Tracer` that are refused before the memory runs out."""

    def memory_needed(
        self, rays: int, query: str = "first_hit", *, max_hits: int | None = None
    ) -> MemoryNeeded:
        """Compute the memory that a query takes, before it runs.

        Parameters
        ----------
        rays : int
            Number of rays.
        query : {"first_hit", "any_hit", "count_hits", "multi_hit"}
        max_hits : int, optional
            Maximum number of hits that `multi_hit` finds per ray; the estimate assumes that every
            ray has as many.

        Returns
        -------
        MemoryNeeded
            Bytes of the host's memory: of the results, and of the working memory.

        Raises
        ------
        ValueError
            If the query is unknown, a number is negative, or `max_hits` is missing: the memory of
            ``multi_hit`` depends on the hits.
        TypeError
            If a number is not an integer.

        Notes
        -----
        This is an upper bound for queries without filters, and for rays in contiguous arrays of
        float32 or float64 (others are copied); the arrays themselves do not count. `results` is
        exact unless rays have fewer hits. On the CPU the total is at most twice the memory used,
        plus 0.3 MB per thread; where ``structure="bvh"`` chooses the kernel by the rays, it allows
        for the one that needs most, 21 MB per thread, or 42 with instances. GPU memory does not
        count: rays are traced there in parts that fit.

        Queries of a million rays or more check that this much memory is free, and raise
        MemoryError with both numbers if it is not; `multi_hit` checks again before it stores hits.

        Examples
        --------
        >>> import raystream as rs
        >>> tracer = rs.Tracer(rs.load("cornell"))
        >>> tracer.memory_needed(10_000_000).results
        170000000
        """
        count = check_least("rays", rays, 0)
        kind = _KINDS.get(query)
        if kind is None:
            raise ValueError(f"query: expected one of {', '.join(_KINDS)}, got {query!r}")
        hits = 0
        if kind is Kind.MULTI_HIT:
            if max_hits is None:
                raise ValueError("max_hits: required, since the memory of multi_hit depends on it")
            hits = count * check_least("max_hits", max_hits, 0)
        return self._needed(kind, count, hits)

    def _needed(self, kind: Kind, count: int, hits: int) -> MemoryNeeded:
        results = _RESULT[kind] * count + _HIT * hits
        if kind is Kind.FIRST_HIT and self.machine == "branching" and self.device == "cpu":
            # A graph names the sectors of hits.
            results += 0 if self.structure.sector_count is None else 4 * count
        working = self._backend.working_bytes(kind, count, hits)
        rows = {Kind.FIRST_HIT: count, Kind.MULTI_HIT: hits}.get(kind, 0)
        if self.structure.triangles.instances is not None:
            results += 4 * rows
            working += split_bytes(rows)
        if self.structure.precision == "float64":
            results += 12 * rows
        if self._counts:
            results += ROW_BYTES * count
        return MemoryNeeded(results, working)

    def _answer(
        self, query: Query, rays: RayBatch, progress: Progress | None, records: Any = None
    ) -> Sink:
        if len(rays) >= CHECKED_RAYS and query.kind in _RESULT:
            needed = self._needed(query.kind, len(rays), 0).total
            name = query.kind.name.lower()
            check_memory(
                needed, f"{name}: {len(rays):,} rays would", "trace fewer at a time, or query_zarr"
            )
        return super()._answer(query, rays, progress, records)
