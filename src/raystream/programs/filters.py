"""Filters: queries in which some hits do not exist."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for
from raystream.kernels.collect import HitArrays
from raystream.programs.program import CHUNK, Program
from raystream.programs.rounds import Answer, Asked, AskHits, visit
from raystream.programs.rows import SkipsAt, as_skips, place_rows
from raystream.structures.batches import allocate_hits

__all__ = ["Filter", "count_filtered", "filter_first", "multi_filtered"]


def _keep_all(hit: Any) -> bool:
    """The filter of a query that only skips triangles: every hit exists."""
    exists: bool = hit.prim_id >= 0
    return exists


class Filter(NamedTuple):
    """Which hits do not exist.

    Attributes
    ----------
    function : callable
        The user's.
    skipped : ndarray of shape (N, k), int32, or None
        Triangles that do not exist for each ray.
    triangles : Triangles
    """

    function: Callable[..., Any]
    skipped: NDArray[np.int32] | None
    triangles: Triangles

    @classmethod
    def of(
        cls, on_hit: Any, skip_prim_ids: Any, shape: tuple[int, ...], triangles: Triangles
    ) -> Filter | None:
        """What the arguments of a query say; None if all hits exist."""
        if on_hit is None and skip_prim_ids is None:
            return None
        skipped = None
        if skip_prim_ids is not None:
            skipped = as_skips(skip_prim_ids, shape, len(triangles))
        return cls(_keep_all if on_hit is None else on_hit, skipped, triangles)

    def program(self, goal: Any, *arguments: Any) -> Program:
        """The filter's loop."""
        skips = None if self.skipped is None else SkipsAt.of(self.skipped)
        return Program(self.function, goal, skips, arguments)


def filter_first(
    filter_: Filter,
    ask: AskHits,
    batch: RayBatch,
    hits: HitArrays,
) -> None:
    """Replace nearest hits that do not exist by the nearest ones that do.

    Parameters
    ----------
    filter_ : Filter
    ask : callable
    batch : RayBatch
    hits : HitArrays
        The nearest hits of all triangles; changed.
    """
    program = filter_.program("first", hits)
    whole = Asked(batch, None, 0)
    open_rays, _ = Answer(whole, None, hits, 0).run(program, filter_.triangles)
    ignored = np.flatnonzero(open_rays & (hits.prim_id >= 0))
    if len(ignored) == 0:
        return
    for array, value in zip(hits, (np.inf, 0.0, 0.0, -1), strict=True):
        array[ignored] = value
    status = np.zeros(len(ignored), np.uint8)
    visit(
        ask,
        whole.part(ignored),
        lambda answer: answer.run(program, filter_.triangles),
        status,
        None,
        delivered=1,
    )


def count_filtered(
    filter_: Filter, ask: AskHits, batch: RayBatch, progress: Progress | None
) -> NDArray[np.int64]:
    """Count the hits of each ray that exist."""
    counts = np.zeros(len(batch), np.int64)
    program = filter_.program("count", counts)
    status = np.zeros(len(batch), np.uint8)
    visit(
        ask,
        Asked(batch, None, 0),
        lambda answer: answer.run(program, filter_.triangles),
        status,
        progress,
    )
    return counts


class _Part(NamedTuple):
    """Rows of some rays that exist, ray after ray, ``counts[i]`` of ray i."""

    asked: Asked
    counts: NDArray[np.int64]
    hits: HitArrays


def multi_filtered(
    filter_: Filter,
    ask: AskHits,
    batch: RayBatch,
    limit: int,
    status: NDArray[np.uint8],
    progress: Progress | None,
) -> tuple[NDArray[np.int64], HitArrays]:
    """Find the nearest `limit` hits of each ray that exist; see `BatchQueries.multi_hit_batch`."""
    if limit == 0:
        return ask(batch, 0, status, progress)
    found = np.zeros(len(batch), np.int64)
    splits = np.zeros(len(batch) + 1, np.int64)
    program = filter_.program("multi", found, np.int64(limit))
    parts: list[_Part] = []

    def visitor(answer: Answer) -> tuple[NDArray[np.bool_], int]:
        counts = np.zeros(len(answer.asked.batch), np.int64)
        result = answer.run(program, filter_.triangles, counts)
        parts.append(_compact(answer, counts))
        return result

    visit(ask, Asked(batch, None, 0), visitor, status, progress)
    np.cumsum(found, out=splits[1:])
    if len(parts) == 1:
        return splits, parts[0].hits
    hits = allocate_hits(int(splits[-1]))
    starts = splits[:-1].copy()
    for asked, counts, rows in parts:
        ids: Any = asked.ids
        if ids is None:
            ids = slice(asked.first, asked.first + len(counts))
        _place(rows, np.cumsum(counts) - counts, counts, starts[ids], hits)
        starts[ids] += counts
    return splits, hits


def _compact(answer: Answer, counts: NDArray[np.int64]) -> _Part:
    """The rows that exist; the loop left them where each ray's new rows begin."""
    asked, splits, hits, delivered = answer
    assert splits is not None
    total = int(counts.sum())
    if total == len(hits.t):
        return _Part(asked, counts, hits)
    firsts = np.minimum(splits[:-1] + delivered, splits[1:])
    kept = HitArrays.empty(total)
    _place(hits, firsts, counts, np.cumsum(counts) - counts, kept)
    return _Part(asked, counts, kept)


def _place(
    rows: HitArrays,
    firsts: NDArray[np.int64],
    counts: NDArray[np.int64],
    starts: NDArray[np.int64],
    out: HitArrays,
) -> None:
    def body(begin: int, end: int) -> None:
        place_rows(begin, end, rows, firsts, counts, starts, out)

    parallel_for(body, len(counts), CHUNK)
