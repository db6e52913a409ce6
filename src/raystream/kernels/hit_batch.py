"""Batches of hits, as a traversal delivers them to multi-hit queries and programs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.threads import parallel_for, thread_count
from raystream.kernels.hits import HitArrays, count_rows, place_rows

__all__ = [
    "CHECKED_HITS",
    "HitAccumulator",
    "HitBatch",
    "HitVisitor",
    "allocate_hits",
    "for_each_chunk",
]

#: From this many hits on the free memory is checked, which takes longer than a small query.
CHECKED_HITS = 1 << 20

#: Fewest and most rays of a chunk of a result that is in memory.
LEAST_PART, MOST_PART = 1 << 13, 1 << 17

#: `ids` of consecutive rays, for kernels.
_NO_IDS = np.empty(0, np.int64)


class HitBatch(NamedTuple):
    """Hits of some of the rays of a query.

    Attributes
    ----------
    hits : HitArrays
        With t in world direction lengths.
    splits : ndarray of shape (n + 1,), int64, or None
        The i-th ray's rows are splits[i] to splits[i + 1]. None if each ray has one row,
        whose prim_id may be -1; or each hit has its own entry in `ids`.
    ids : ndarray of shape (n,), int64, or None
        The rays' indices in the batch; None if they are consecutive. Without splits: int32.
    first : int
        The first one's index, if they are consecutive.
    """

    hits: HitArrays
    splits: NDArray[np.int64] | None
    ids: NDArray[np.int64] | NDArray[np.int32] | None
    first: int

    def __len__(self) -> int:
        return len(self.hits.t) if self.splits is None else len(self.splits) - 1

    @property
    def hit_count(self) -> int:
        """Rows of all rays."""
        if self.splits is None:
            return len(self.hits.t)
        return int(self.splits[-1] - self.splits[0])

    @property
    def rays(self) -> slice | NDArray[np.int64] | NDArray[np.int32]:
        """The rays' indices in the batch, to index arrays with."""
        return slice(self.first, self.first + len(self)) if self.ids is None else self.ids


#: Called from several threads; the hits' memory is reused after the call.
HitVisitor = Callable[[HitBatch], object]


def for_each_chunk(found: HitBatch, visitor: HitVisitor) -> None:
    """Give hits of consecutive rays, all in memory, to a visitor in chunks, on all threads."""

    def body(begin: int, end: int) -> None:
        rows = slice(begin, end)
        if found.splits is None:
            visitor(HitBatch(found.hits.part(rows), None, None, found.first + begin))
        elif begin != end:
            splits = found.splits[begin : end + 1]
            visitor(HitBatch(found.hits, splits, None, found.first + begin))

    share = -(-len(found) // (4 * thread_count()))
    parallel_for(body, len(found), max(LEAST_PART, min(share, MOST_PART)))


def allocate_hits(count: int) -> HitArrays:
    """Allocate the hits of `multi_hit`; raises MemoryError if there is not enough memory."""
    if count >= CHECKED_HITS:
        _check_hits(count)
    return HitArrays.empty(count)


def _check_hits(count: int) -> None:
    remedy = "give max_hits, or fewer rays at a time"
    check_memory(count * 16, f"multi_hit: {count:,} hits would", remedy)


class HitAccumulator:
    """Copies of batches of hits, joined at the end.

    Parameters
    ----------
    ray_count : int
        Rays of the batch.
    """

    def __init__(self, ray_count: int) -> None:
        self._counts = np.zeros(ray_count, np.int64)
        self._parts: list[HitBatch] = []
        self._in_order = False
        self._found = 0
        self._unchecked = CHECKED_HITS
        count_rows(np.zeros(1, np.int64), _NO_IDS, 0, self._counts)  # compile on this thread

    def take(self, found: HitBatch, again: bool = False) -> None:
        """Copy a batch with splits; a `HitVisitor`.

        Parameters
        ----------
        found : HitBatch
        again : bool
            Whether its rays had hits in earlier batches, which come first.
        """
        splits = found.splits
        assert splits is not None
        self._in_order |= again
        begin, end = int(splits[0]), int(splits[-1])
        if begin == end:
            return
        self._found += end - begin
        if self._found >= self._unchecked:  # before the memory for `whole` runs out
            self._unchecked = self._found + CHECKED_HITS
            _check_hits(self._found)
        ids = _NO_IDS if found.ids is None else found.ids.astype(np.int64)
        part = HitBatch(found.hits.copy_of(slice(begin, end)), splits - begin, ids, found.first)
        count_rows(part.splits, ids, part.first, self._counts)
        self._parts.append(part)

    def whole(self) -> tuple[NDArray[np.int64], HitArrays]:
        """All hits in the order of the batch: splits of shape (N + 1,), and rows."""
        splits = np.zeros(len(self._counts) + 1, np.int64)
        np.cumsum(self._counts, out=splits[1:])
        hits = allocate_hits(int(splits[-1]))
        nexts = splits[:-1].copy()

        def body(begin: int, end: int) -> None:
            if begin == end:  # compile
                place_rows(hits, np.zeros(1, np.int64), _NO_IDS, 0, nexts, hits)
            for part in self._parts[begin:end]:
                place_rows(part.hits, part.splits, part.ids, part.first, nexts, hits)

        count = len(self._parts)
        parallel_for(body, count, count if self._in_order else 1)
        return splits, hits
