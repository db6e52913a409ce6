"""Sink: where the answers of a query go."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.kernels.hit_batch import HitBatch, HitVisitor, for_each_chunk
from raystream.kernels.hits import HitArrays, aligned_rows
from raystream.kernels.tally import new_tallies

__all__ = ["Sink"]


class Sink:
    """Where the answers of a query go: made before it runs, read afterwards.

    Which of the attributes there are depends on the kind of the query.

    Attributes
    ----------
    status : ndarray of shape (N,), uint8
        A `RayStatus` for each ray: VALID before, changed for invalid ones.
    hits : HitArrays
        Of `Kind.FIRST_HIT`, row i is ray i's: a miss has t = inf and prim_id = -1. Of
        `Kind.MULTI_HIT`, all rows. World distances, in direction lengths.
    memory : ndarray of shape (4, M), float32
        What the rows of `Kind.FIRST_HIT` are views of, aligned to cache lines.
    seen : ndarray of shape (N,), bool
        Of `Kind.ANY_HIT`: whether anything is in the ray's way.
    counts : ndarray of shape (N,), int64
        Of `Kind.COUNT_HITS`.
    splits : ndarray of shape (N + 1,), int64
        Of `Kind.MULTI_HIT`: ray i owns the rows splits[i] to splits[i + 1].
    visitor : callable
        Of `Kind.MULTI_HIT`: if given, it gets the hits in batches, and there are no `splits`
        and `hits`. Called on several threads.
    records : ndarray of shape (N,) or (N, k)
        Of `Kind.TRACE`: each ray's payload, changed in place; None if the program takes none.
    tallies : ndarray of shape (N, 8), uint32
        If the query counts: what each ray meets is added to its row; see `kernels.tally`.
    """

    hits: HitArrays
    memory: NDArray[np.float32]
    seen: NDArray[np.bool_]
    counts: NDArray[np.int64]
    splits: NDArray[np.int64]

    __slots__ = (
        "counts",
        "hits",
        "memory",
        "records",
        "seen",
        "splits",
        "status",
        "tallies",
        "visitor",
    )

    def __init__(
        self,
        status: NDArray[np.uint8],
        *,
        visitor: HitVisitor | None = None,
        records: NDArray[Any] | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        self.status = status
        self.visitor = visitor
        self.records = records
        self.tallies = tallies

    @classmethod
    def of(
        cls,
        query: Query,
        count: int,
        records: NDArray[Any] | None = None,
        status: NDArray[np.uint8] | None = None,
    ) -> Sink:
        """Memory for the answers of a query of `count` rays; its own status unless given."""
        sink = cls(
            np.zeros(count, np.uint8) if status is None else status,
            records=records,
            tallies=new_tallies(count) if query.counters else None,
        )
        kind = query.kind
        if kind is Kind.FIRST_HIT:
            sink.memory = aligned_rows(count)
            sink.hits = HitArrays.rows_of(sink.memory)
        elif kind is Kind.ANY_HIT:
            sink.seen = np.empty(count, np.bool_)
        elif kind is Kind.COUNT_HITS:
            sink.counts = np.empty(count, np.int64)
        return sink

    def part(self, rows: slice) -> Sink:
        """The same memory, of some consecutive rays; of `Kind.MULTI_HIT`, with all hits."""
        tallies = None if self.tallies is None else self.tallies[rows]
        part = Sink(self.status[rows], tallies=tallies)
        if hasattr(self, "splits"):
            part.splits, part.hits = self.splits[rows.start : rows.stop + 1], self.hits
        elif hasattr(self, "hits"):
            part.hits = self.hits.part(rows)
        elif hasattr(self, "seen"):
            part.seen = self.seen[rows]
        elif hasattr(self, "counts"):
            part.counts = self.counts[rows]
        return part

    def put(self, splits: NDArray[np.int64], hits: HitArrays) -> None:
        """Take all hits of `Kind.MULTI_HIT` at once."""
        if self.visitor is None:
            self.splits, self.hits = splits, hits
        else:
            for_each_chunk(HitBatch(hits, splits, None, 0), self.visitor)
