"""Reuse distances: the misses of fully associative caches of every size."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.memory import check_memory
from raystream.core.rays import as_host_array
from raystream_lab.caches.kernels.fast_division import divisor
from raystream_lab.caches.kernels.hash_table import home_shift
from raystream_lab.caches.kernels.ranked_bits import BITS, BLOCK_WORDS, ROW_BLOCKS, RankedBits
from raystream_lab.caches.kernels.stack_distances import (
    Clock,
    Histogram,
    Latest,
    move_entries,
    move_times,
    run_distances,
)
from raystream_lab.caches.line_counts import LineCounts, by_kind, new_counts
from raystream_lab.caches.trace_chunk import MIN_LINE_SIZE, Kinds, as_chunk, as_count, as_kinds

#: A reference touches at most this many lines: 255 bytes, in lines of 4.
_MAX_TOUCHED = 65

#: Larger cache sizes are clamped to this.
_MAX_BYTES = (1 << 63) - 1


class MissCurve(NamedTuple):
    """Misses of fully associative LRU caches.

    Attributes
    ----------
    sizes : ndarray of shape (S,), int64
        Bytes of each cache.
    misses : ndarray of shape (S, K), int64
        Per cache and kind of data.
    accesses : ndarray of shape (K,), int64
        Per kind of data.
    """

    sizes: NDArray[np.int64]
    misses: NDArray[np.int64]
    accesses: NDArray[np.int64]

    @property
    def hit_rates(self) -> NDArray[np.float64]:
        """Share of all accesses that hit, of shape (S,); nan without accesses."""
        count = int(self.accesses.sum())
        missed = self.misses.sum(axis=1)
        return 1.0 - missed / count if count else np.full(len(missed), np.nan)


class ReuseDistances:
    """Exact LRU stack distances of a trace.

    The distance of an access is the number of other lines accessed since the last access to its
    line. A fully associative LRU cache misses where the distance is at least its number of lines
    (Mattson et al. 1970 [1]_), so the distances of one run give the misses of every size.

    Parameters
    ----------
    line_size : int
        Bytes per line, at least 4; need not be a power of two.
    kinds : sequence of str
        Names of the kinds of data to count separately, at most 256. An access counts for the kind
        of its reference.

    Attributes
    ----------
    line_size : int
    kinds : tuple of str

    Raises
    ------
    TypeError, ValueError
        If an option has the wrong type or is out of range.

    Notes
    -----
    Distances are counted exactly, without binning. Memory is bounded by the number of distinct
    lines, not by the length of the trace: 34 to 68 bytes per line, and 8 to 16 more per kind; half
    as much again while a table grows, and as much again per kind while misses are computed.

    References
    ----------
    .. [1] Mattson, Gecsei, Slutz and Traiger, "Evaluation techniques for storage hierarchies",
       IBM Systems Journal 9(2), 1970.

    Examples
    --------
    >>> distances = ReuseDistances(48)
    >>> distances.access(np.array([0, 4, 48, 96, 0], np.uint64))
    >>> distances.line_count, distances.misses([48, 96, 144]).tolist()
    (3, [4, 4, 3])
    """

    #: Initial size of the table and of the time line: powers of two.
    _first_capacity = 1 << 12
    _first_end = 1 << 16

    #: Minimum size of a compacted time line, in multiples of the number of lines.
    _times_per_line = 8

    def __init__(self, line_size: int, *, kinds: Sequence[str] = ("all",)) -> None:
        self.line_size = as_count("line_size", line_size, MIN_LINE_SIZE)
        self.kinds = as_kinds(kinds)
        self._divisor = divisor(self.line_size)
        self.clear()

    def clear(self) -> None:
        """Forget the trace and reset the counts."""
        self._counts = new_counts(len(self.kinds))
        self._clock = np.zeros(3, np.uint64)
        self._entries = np.zeros((self._first_capacity, 2), np.uint64)
        self._histogram = np.zeros((len(self.kinds), self._first_capacity // 2), np.uint64)
        self._latest = _table_of(self._entries)
        self._start(self._first_end, _first_bits(self._first_end, 0))

    @property
    def line_count(self) -> int:
        """Number of distinct lines accessed, whose first accesses miss in every cache."""
        return int(self._clock[1])

    def access(self, addresses: NDArray[np.uint64], kinds: Kinds = 0, lengths: Kinds = 4) -> None:
        """Process the next chunk of a trace; see `Cache.access`.

        Raises
        ------
        TypeError, ValueError
            If an array has the wrong dtype or shape, or a value is out of range; nothing is
            counted.
        MemoryError
            If there are too many distinct lines for the available memory; part of the chunk has
            been counted.
        """
        chunk = as_chunk(addresses, kinds, lengths, len(self.kinds))
        start = np.uint64(0)
        while True:
            start = np.uint64(
                run_distances(
                    chunk.trace,
                    start,
                    chunk.reference_count,
                    self._divisor,
                    self._latest,
                    self._bits,
                    Clock(_address(self._clock), np.uint64(self._end)),
                    Histogram(_address(self._histogram), np.uint64(self._histogram.shape[1])),
                    _address(self._counts),
                )
            )
            if start == chunk.reference_count:
                return
            self._make_room()

    def misses(self, sizes: ArrayLike) -> NDArray[np.int64]:
        """Count the misses of fully associative caches, over all kinds.

        Parameters
        ----------
        sizes : array_like of int
            Bytes of each cache, any shape; a cache smaller than a line never hits.

        Returns
        -------
        ndarray of the shape of sizes, int64
        """
        wanted = _as_sizes(sizes)
        return self._misses(wanted).sum(axis=-1)

    def curve(self, sizes: ArrayLike | None = None) -> MissCurve:
        """Misses of fully associative caches by kind.

        Parameters
        ----------
        sizes : array_like of int, of shape (S,), optional
            Bytes of each cache [default: from one line to all lines, four sizes per doubling].

        Returns
        -------
        MissCurve
        """
        if sizes is None:
            doublings = int(np.ceil(4.0 * np.log2(max(self.line_count, 1))))
            lines = np.unique(np.ceil(2.0 ** (np.arange(doublings + 1) / 4.0)).astype(np.int64))
            wanted = lines * self.line_size
        else:
            wanted = _as_sizes(sizes)
            if wanted.ndim != 1:
                raise ValueError(f"sizes: must have shape (S,), not {wanted.shape}")
        return MissCurve(wanted, self._misses(wanted), self._counts[:, 2].astype(np.int64))

    def counts(self, size: int) -> MappingProxyType[str, LineCounts]:
        """Counts of a fully associative cache of a given size, by kind of data."""
        wanted = np.array(min(as_count("size", size, 0), _MAX_BYTES), np.int64)
        missed = self._misses(wanted).astype(np.uint64)
        return by_kind(self.kinds, self._counts, missed, self.line_size)

    def histogram(self) -> NDArray[np.int64]:
        """Number of accesses at each distance, by kind.

        Returns
        -------
        ndarray of shape (K, D), int64
            For distances 0 to D - 1, where D is `line_count`. First accesses have no distance and
            are excluded.
        """
        return self._histogram[:, : self.line_count].astype(np.int64)

    def _misses(self, sizes: NDArray[np.int64]) -> NDArray[np.int64]:
        """Misses of caches by kind, of shape (*S, K)."""
        accesses = self._counts[:, 2].astype(np.int64)
        lines = np.minimum(sizes // self.line_size, self.line_count)
        hits = np.zeros((len(self.kinds), self.line_count + 1), np.int64)
        np.cumsum(self.histogram(), axis=1, out=hits[:, 1:])
        return accesses - np.moveaxis(hits[:, lines], 0, -1)

    def _make_room(self) -> None:
        """Enlarge the table or compact the time line for another reference."""
        if self.line_count + _MAX_TOUCHED > len(self._entries) // 2:
            self._grow_table()
        if int(self._clock[0]) + _MAX_TOUCHED > self._end:
            self._compact()

    def _grow_table(self) -> None:
        former, capacity = self._latest, 2 * len(self._entries)
        while self.line_count + _MAX_TOUCHED > capacity // 2:
            capacity *= 2
        check_memory(capacity * (16 + 4 * len(self.kinds)), f"{capacity // 2:,} lines would")
        # Allocate both before replacing either: the kernel relies on their lengths.
        entries = np.zeros((capacity, 2), np.uint64)
        histogram = np.zeros((len(self.kinds), capacity // 2), np.uint64)
        histogram[:, : self.line_count] = self._histogram[:, : self.line_count]
        latest = _table_of(entries)
        move_entries(former, latest)
        self._entries, self._latest, self._histogram = entries, latest, histogram

    def _compact(self) -> None:
        """Compact the set bits to the start of the time line, and lengthen it if needed."""
        end = self._end
        while end < self._times_per_line * self.line_count + 2 * _MAX_TOUCHED:
            end *= 2
        parts = _first_bits(end, self.line_count)
        words = self._parts[0]
        before = np.cumsum(np.bitwise_count(words), dtype=np.uint64)
        before -= np.bitwise_count(words)
        move_times(self._latest, _address(words), _address(before))
        self._start(end, parts)

    def _start(self, end: int, parts: list[NDArray[np.uint64]]) -> None:
        """Start a time line; the clock is set after the set bits."""
        self._end, self._parts = end, parts
        self._bits = RankedBits(*map(_address, parts))
        self._clock[0] = self.line_count


def _address(array: NDArray[np.uint64]) -> np.uint64:
    return np.uint64(array.ctypes.data)


def _table_of(entries: NDArray[np.uint64]) -> Latest:
    capacity = len(entries)
    numbers = home_shift(capacity), capacity - 1, capacity // 2
    return Latest(_address(entries), *(np.uint64(number) for number in numbers))


def _first_bits(end: int, count: int) -> list[NDArray[np.uint64]]:
    """A bitmap whose first `count` bits are set: words, blocks and rows, padded to 64s."""
    words = np.zeros(_in_64s(end, BITS), np.uint64)
    words[: count // BITS] = ~np.uint64(0)
    if count % BITS:
        words[count // BITS] = (1 << (count % BITS)) - 1
    sums = [words]
    for part in (BITS * BLOCK_WORDS, BITS * BLOCK_WORDS * ROW_BLOCKS):
        begins = part * np.arange(_in_64s(end, part))
        sums.append(np.clip(count - begins, 0, part).astype(np.uint64))
    return sums


def _in_64s(end: int, part: int) -> int:
    """Number of parts of a given length in a time line, rounded up to a multiple of 64."""
    return -(-end // (64 * part)) * 64


def _as_sizes(sizes: ArrayLike) -> NDArray[np.int64]:
    array = as_host_array("sizes", sizes)
    if array.dtype.kind not in "iu":
        raise TypeError(f"sizes: must be integers, not {array.dtype}")
    if array.size and int(array.min()) < 0:
        raise ValueError(f"sizes: must not be negative, got {array.min()}")
    return np.minimum(array, _MAX_BYTES).astype(np.int64)
