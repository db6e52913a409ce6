"""Sink: the memory for a query's results."""

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
    """The results of a query: allocated before it runs, read afterwards.

    The kind of the query determines which attributes exist.

    Attributes
    ----------
    status : ndarray of shape (N,), uint8
        A `RayStatus` per ray: VALID before the query, changed for invalid ones.
    hits : HitArrays
        Of `Kind.FIRST_HIT`, row i is ray i's: a miss has t = inf and prim_id = -1. Of
        `Kind.MULTI_HIT`, all rows. World distances, in direction lengths.
    memory : ndarray of shape (4, M), float32
        The memory of the rows of `Kind.FIRST_HIT`, aligned to cache lines.
    seen : ndarray of shape (N,), bool
        Of `Kind.ANY_HIT`: whether anything is in the ray's way.
    counts : ndarray of shape (N,), int64
        Of `Kind.COUNT_HITS`.
    splits : ndarray of shape (N + 1,), int64
        Of `Kind.MULTI_HIT`: ray i owns the rows splits[i] to splits[i + 1].
    visitor : callable
        Of `Kind.MULTI_HIT`: if given, it takes the hits in batches, and `splits` and `hits` are
        not set. Called from several threads.
    records : ndarray of shape (N,) or (N, k)
        Of `Kind.TRACE`: each ray's payload, changed in place; None if the program takes none.
    tallies : ndarray of shape (N, 8), uint32
        If the query counts: each ray's counts are added to its row; see `kernels.tally`.
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
        """Allocate the results of a query of `count` rays; also the status unless given."""
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
        """A view of some consecutive rays; of `Kind.MULTI_HIT`, with all hits."""
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
        """Store or deliver all hits of `Kind.MULTI_HIT`."""
        if self.visitor is None:
            self.splits, self.hits = splits, hits
        else:
            for_each_chunk(HitBatch(hits, splits, None, 0), self.visitor)
