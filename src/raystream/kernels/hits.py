"""Hits in memory: arrays, batches that a traversal delivers, and the sink of a query's results."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.query import Kind, Query
from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address
from raystream.jit.threads import parallel_for, thread_count
from raystream.kernels.aligned import array_address
from raystream.kernels.tally import new_tallies

#: From this many hits on the free memory is checked, which takes longer than a small query.
CHECKED_HITS = 1 << 20

#: Fewest and most rays of a chunk of a result that is in memory.
LEAST_PART, MOST_PART = 1 << 13, 1 << 17

#: `ids` of consecutive rays, for kernels.
_NO_IDS = np.empty(0, np.int64)

#: NumPy converts a type to it at each use.
_INT32 = np.dtype(np.int32)


class HitArrays(NamedTuple):
    """Hits in memory, a column for each attribute.

    Attributes
    ----------
    t, u, v : ndarray of shape (K,), float32, or float64 in tracers of that precision
    prim_id : ndarray of shape (K,), int32
    """

    t: NDArray[Any]
    u: NDArray[Any]
    v: NDArray[Any]
    prim_id: NDArray[np.int32]

    @property
    def capacity(self) -> int:
        """Rows: all are the memory's."""
        return len(self.t)

    def part(self, rows: slice) -> HitArrays:
        """A view of some rows."""
        return HitArrays(self.t[rows], self.u[rows], self.v[rows], self.prim_id[rows])

    def copy_of(self, rows: slice) -> HitArrays:
        """Copies of some rows."""
        t, u, v, prim_id = self.part(rows)
        return HitArrays(t.copy(), u.copy(), v.copy(), prim_id.copy())

    @classmethod
    def empty(cls, count: int, kind: type[np.floating[Any]] = np.float32) -> HitArrays:
        """Uninitialised arrays for `count` hits; of float32, as parts of one allocation.

        NumPy requests huge pages for allocations above 4 MB only.
        """
        if kind is np.float32:
            return cls.rows_of(np.empty((4, count), np.float32))
        t, u, v = (np.empty(count, kind) for _ in range(3))
        return cls(t, u, v, np.empty(count, np.int32))

    @staticmethod
    def row_bytes(kind: type[np.floating[Any]]) -> int:
        """Bytes of a hit."""
        return 3 * np.dtype(kind).itemsize + 4

    @classmethod
    def rows_of(cls, memory: NDArray[np.float32]) -> HitArrays:
        """The rows of an array of shape (4, K) as t, u, v and prim_id."""
        t, u, v, bits = memory
        return cls(t, u, v, bits.view(_INT32))


#: Rows of at least this many hits are aligned to cache lines.
_LONG_ROWS = 4096


def aligned_rows(count: int) -> NDArray[np.float32]:
    """Uninitialised array of shape (4, count), for `HitArrays.rows_of`.

    Long rows begin at multiples of 64 bytes, so that kernels can write whole cache lines
    past the cache.
    """
    if count < _LONG_ROWS:
        return np.empty((4, count), np.float32)
    stride = -(-count // 16) * 16
    memory = np.empty(4 * stride + 16, np.float32)
    skipped = -memory.ctypes.data % 64 // 4
    return memory[skipped : skipped + 4 * stride].reshape(4, stride)[:, :count]


class HitAddresses(NamedTuple):
    """`HitArrays` for traversals, as addresses: passing an array costs two atomic operations.

    Attributes
    ----------
    t, u, v, prim_id : uint64
        Addresses of the first hit's numbers.
    """

    t: np.uint64
    u: np.uint64
    v: np.uint64
    prim_id: np.uint64

    @classmethod
    def of(cls, hits: HitArrays) -> HitAddresses:
        """Addresses of hits; the caller keeps the arrays alive."""
        t, u, v, prim_id = hits
        return cls(
            np.uint64(array_address(t)),
            np.uint64(array_address(u)),
            np.uint64(array_address(v)),
            np.uint64(array_address(prim_id)),
        )

    @classmethod
    def of_rows(cls, address: int | np.uint64, count: int, item_bytes: int = 4) -> HitAddresses:
        """Addresses of the rows of an array of shape (4, count)."""
        at, step = int(address), item_bytes * count
        rows = np.uint64(at), np.uint64(at + step), np.uint64(at + 2 * step)
        return cls(*rows, np.uint64(at + 3 * step))


@device
def hit_addresses(out):
    """`HitAddresses` of a kernel's `HitArrays`, which its caller keeps alive."""
    return HitAddresses(address(out.t), address(out.u), address(out.v), address(out.prim_id))


@kernel
def copy_rows(begin, end, rows, firsts, counts, starts, out):
    """Copy ``counts[i]`` rows, from row ``firsts[i]`` to row ``starts[i]`` of `out`.

    Parameters
    ----------
    begin, end : int
    rows, out : HitArrays
    firsts, counts, starts : ndarray of shape (N,), int64
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        row, to = np.uint64(firsts[i]), np.uint64(starts[i])
        for _ in range(np.uint64(counts[i])):
            out.t[to] = rows.t[row]
            out.u[to] = rows.u[row]
            out.v[to] = rows.v[row]
            out.prim_id[to] = rows.prim_id[row]
            row += ONE_U64
            to += ONE_U64


@kernel
def count_rows(splits, ids, first, counts):
    """Add the hits of some rays to the rays' counts.

    Parameters
    ----------
    splits : ndarray of shape (n + 1,), int64
        The i-th ray's rows are splits[i] to splits[i + 1].
    ids : ndarray of shape (n,), int64
        The rays' indices; empty if they are consecutive.
    first : int
        The first one's index, if they are consecutive.
    counts : ndarray of shape (N,), int64
        Changed in place.
    """
    for i in range(np.uint64(len(splits) - 1)):
        ray = np.uint64(ids[i]) if len(ids) else np.uint64(first) + i
        counts[ray] += splits[i + ONE_U64] - splits[i]


@kernel
def place_rows(rows, splits, ids, first, nexts, out):
    """Scatter the hits of some rays to their rows of the whole result.

    Parameters
    ----------
    rows, out : HitArrays
    splits, ids, first
        See `count_rows`.
    nexts : ndarray of shape (N,), int64
        The next free row of each ray in `out`; advanced.
    """
    for i in range(np.uint64(len(splits) - 1)):
        ray = np.uint64(ids[i]) if len(ids) else np.uint64(first) + i
        to = np.uint64(nexts[ray])
        for row in range(np.uint64(splits[i]), np.uint64(splits[i + ONE_U64])):
            out.t[to] = rows.t[row]
            out.u[to] = rows.u[row]
            out.v[to] = rows.v[row]
            out.prim_id[to] = rows.prim_id[row]
            to += ONE_U64
        nexts[ray] = np.int64(to)


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


def allocate_hits(count: int, kind: type[np.floating[Any]] = np.float32) -> HitArrays:
    """Allocate the hits of `multi_hit`; raises MemoryError if there is not enough memory."""
    if count >= CHECKED_HITS:
        _check_hits(count, kind)
    return HitArrays.empty(count, kind)


def _check_hits(count: int, kind: type[np.floating[Any]] = np.float32) -> None:
    remedy = "give max_hits, or fewer rays at a time"
    check_memory(count * HitArrays.row_bytes(kind), f"multi_hit: {count:,} hits would", remedy)


@cache
def _compile_counting() -> None:
    """Compile what threads call, on the calling one."""
    count_rows(np.zeros(1, np.int64), _NO_IDS, 0, np.zeros(0, np.int64))


class HitAccumulator:
    """Copies of batches of hits, joined at the end.

    Parameters
    ----------
    ray_count : int
        Rays of the batch.
    kind : type
        Of t, u and v.
    """

    def __init__(self, ray_count: int, kind: type[np.floating[Any]] = np.float32) -> None:
        self._kind = kind
        self._counts = np.zeros(ray_count, np.int64)
        self._parts: list[HitBatch] = []
        self._in_order = False
        self._found = 0
        self._unchecked = CHECKED_HITS
        _compile_counting()

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
            _check_hits(self._found, self._kind)
        ids = _NO_IDS if found.ids is None else found.ids.astype(np.int64)
        part = HitBatch(found.hits.copy_of(slice(begin, end)), splits - begin, ids, found.first)
        count_rows(part.splits, ids, part.first, self._counts)
        self._parts.append(part)

    def whole(self) -> tuple[NDArray[np.int64], HitArrays]:
        """All hits in the order of the batch: splits of shape (N + 1,), and rows."""
        if len(self._parts) == 1:  # of a small batch
            only, found, ids, _ = self._parts[0]
            if ids is _NO_IDS and found is not None and len(found) == len(self._counts) + 1:
                return found, only
        splits = np.zeros(len(self._counts) + 1, np.int64)
        np.cumsum(self._counts, out=splits[1:])
        hits = allocate_hits(int(splits[-1]), self._kind)
        nexts = splits[:-1].copy()

        def body(begin: int, end: int) -> None:
            if begin == end:  # compile
                place_rows(hits, np.zeros(1, np.int64), _NO_IDS, 0, nexts, hits)
            for part in self._parts[begin:end]:
                place_rows(part.hits, part.splits, part.ids, part.first, nexts, hits)

        count = len(self._parts)
        parallel_for(body, count, count if self._in_order else 1)
        return splits, hits


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
        The memory of the rows of `Kind.FIRST_HIT` in float32, aligned to cache lines.
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
    sectors : ndarray of shape (N,), int32, or None
        Of `Kind.FIRST_HIT` in a graph, from the branching machine: the sectors of the hits.
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
        "sectors",
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
        self.sectors: NDArray[np.int32] | None = None

    @classmethod
    def of(
        cls,
        query: Query,
        count: int,
        records: NDArray[Any] | None = None,
        status: NDArray[np.uint8] | None = None,
        kind: type[np.floating[Any]] = np.float32,
    ) -> Sink:
        """Allocate the results of a query of `count` rays; also the status unless given.

        Distances and weights are of type `kind`.
        """
        sink = cls(
            np.zeros(count, np.uint8) if status is None else status,
            records=records,
            tallies=new_tallies(count) if query.counters else None,
        )
        if query.kind is Kind.FIRST_HIT and kind is np.float32:
            sink.memory = aligned_rows(count)
            sink.hits = HitArrays.rows_of(sink.memory)
        elif query.kind is Kind.FIRST_HIT:
            sink.hits = HitArrays.empty(count, kind)
        elif query.kind is Kind.ANY_HIT:
            sink.seen = np.empty(count, np.bool_)
        elif query.kind is Kind.COUNT_HITS:
            sink.counts = np.empty(count, np.int64)
        return sink

    @property
    def nearest(self) -> HitAddresses:
        """Where the hits of `Kind.FIRST_HIT` go."""
        memory = getattr(self, "memory", None)
        if memory is None:
            return HitAddresses.of(self.hits)
        return HitAddresses.of_rows(array_address(memory), memory.strides[0], item_bytes=1)

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
