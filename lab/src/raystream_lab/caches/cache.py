"""A cache simulator: direct-mapped, set-associative or fully associative, with LRU replacement."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream_lab.caches.kernels.direct_mapped import run_direct
from raystream_lab.caches.kernels.fast_division import divisor
from raystream_lab.caches.kernels.hash_table import MIN_CAPACITY, home_shift
from raystream_lab.caches.kernels.hashed_sets import Rings, run_linked
from raystream_lab.caches.kernels.set_associative import run_sets
from raystream_lab.caches.line_counts import LineCounts, by_kind, new_counts
from raystream_lab.caches.trace_chunk import (
    MIN_LINE_SIZE,
    Chunk,
    Kinds,
    as_chunk,
    as_count,
    as_kinds,
)

#: Slots have 32-bit indices.
_MAX_LINES = 1 << 31


class Cache:
    """A simulated cache that evicts the least recently used line of a set.

    Starts empty. Only reads are simulated, as in a texture cache: omit writes from the trace.

    Parameters
    ----------
    size : int
        Bytes.
    line_size : int
        Bytes per line, at least 4; need not be a power of two.
    ways : int or None
        Lines per set: 1 is direct-mapped, None is fully associative (one set).
    kinds : sequence of str
        Names of the kinds of data to count separately, at most 256.

    Attributes
    ----------
    size, line_size, ways : int
    set_count : int
        Number of sets.
    unused_size : int
        Bytes of `size` that cannot hold a line; see Notes.
    kinds : tuple of str

    Raises
    ------
    TypeError, ValueError
        If an option is not an integer or is out of range: the cache must hold a line and a set.
    MemoryError
        If the simulated cache has too many lines for the available memory.

    Notes
    -----
    Byte a is in line ``a // line_size``, and line n in set ``n % set_count``, also if the number of
    sets is not a power of two. There are ``size // line_size`` lines, grouped into whole sets; the
    remainder is unused. Purcell's texture cache (2002, section 4.2), 64 KB direct-mapped with lines
    of 48 bytes, has 1365 sets, and 16 bytes are not used. Lines begin at multiples of `line_size`
    from address 0, so align arrays in a trace accordingly.

    Sets of up to 32 ways are lists in LRU order; larger ones use a hash table.

    Examples
    --------
    >>> cache = Cache(64 * 1024, 48)
    >>> cache.set_count, cache.unused_size
    (1365, 16)
    >>> cache.access(np.arange(0, 4800, 12, dtype=np.uint64), lengths=12)
    >>> cache.total.hit_rate
    0.75
    """

    #: Sets of more ways than this have a hash table instead of a list.
    _longest_list = 32

    def __init__(
        self,
        size: int,
        line_size: int,
        ways: int | None = 1,
        *,
        kinds: Sequence[str] = ("all",),
    ) -> None:
        self.line_size = as_count("line_size", line_size, MIN_LINE_SIZE)
        self.size = as_count("size", size, 1)
        line_count = self.size // self.line_size
        if line_count < 1:
            raise ValueError(
                f"size: {self.size} bytes are less than a line of line_size={self.line_size}"
            )
        if line_count > _MAX_LINES:
            raise ValueError(f"size: {line_count:,} lines are more than {_MAX_LINES:,}")
        self.ways = line_count if ways is None else as_count("ways", ways, 1)
        if self.ways > line_count:
            raise ValueError(f"ways: {self.ways} lines are more than the {line_count} of the cache")
        self.set_count = line_count // self.ways
        self.unused_size = self.size - self.set_count * self.ways * self.line_size
        self.kinds = as_kinds(kinds)
        self._line_divisor = divisor(self.line_size)
        self._set_divisor = divisor(self.set_count)
        self._is_linked = self.ways > self._longest_list
        check_memory(line_count * (40 if self._is_linked else 8), f"{line_count:,} lines would")
        self.clear()

    def clear(self) -> None:
        """Empty the cache and reset the counts."""
        line_count = self.set_count * self.ways
        self._counts = new_counts(len(self.kinds))
        self._held = np.zeros(line_count, np.uint64)
        if self._is_linked:
            self._rings, self._ring_arrays = _new_rings(self._held, self.set_count, self.ways)

    def access(self, addresses: NDArray[np.uint64], kinds: Kinds = 0, lengths: Kinds = 4) -> None:
        """Process the next chunk of a trace.

        Parameters
        ----------
        addresses : ndarray of shape (N,), uint64
            Address of the first byte of each reference, in read order.
        kinds : int or ndarray of shape (N,), uint8
            Index into `kinds` of each reference, or one for all.
        lengths : int or ndarray of shape (N,), uint8
            Bytes of each reference, from 1 to 255: 4 for a word, 12 or 16 for a texel. A reference
            accesses every line that it overlaps.

        Raises
        ------
        TypeError, ValueError
            If an array has the wrong dtype or shape, or a value is out of range; the cache is
            unchanged.
        """
        chunk = as_chunk(addresses, kinds, lengths, len(self.kinds))
        self._run(chunk)

    def _run(self, chunk: Chunk) -> None:
        divisors = self._line_divisor, self._set_divisor
        counts = np.uint64(self._counts.ctypes.data)
        held = np.uint64(self._held.ctypes.data)
        if self._is_linked:
            run_linked(chunk.trace, chunk.reference_count, *divisors, self._rings, counts)
        elif self.ways == 1:
            run_direct(chunk.trace, chunk.reference_count, *divisors, held, counts)
        else:
            run_sets(
                chunk.trace, chunk.reference_count, *divisors, np.uint64(self.ways), held, counts
            )

    @property
    def counts(self) -> MappingProxyType[str, LineCounts]:
        """Counts so far, by kind of data."""
        return by_kind(self.kinds, self._counts, self._counts[:, 3], self.line_size)

    @property
    def total(self) -> LineCounts:
        """Counts so far, over all kinds."""
        first, *others = self.counts.values()
        return sum(others, first)

    def __repr__(self) -> str:
        return (
            f"Cache({self.size}, {self.line_size}, ways={self.ways}): {self.set_count} sets, "
            f"{self.unused_size} bytes unused"
        )


def _new_rings(
    keys: NDArray[np.uint64], set_count: int, ways: int
) -> tuple[Rings, tuple[NDArray[np.uint32], ...]]:
    """Rings of empty slots, and the arrays that they point to."""
    slots = np.arange(set_count * ways, dtype=np.uint32).reshape(set_count, ways)
    older, newer = np.roll(slots, -1, axis=1), np.roll(slots, 1, axis=1)
    latest = slots[:, 0].copy()
    capacity = max(MIN_CAPACITY, 1 << (2 * slots.size - 1).bit_length())
    table = np.zeros(capacity, np.uint32)
    numbers = (
        *(table.ctypes.data, home_shift(capacity), capacity - 1, keys.ctypes.data),
        *(older.ctypes.data, newer.ctypes.data, latest.ctypes.data),
    )
    return Rings(*(np.uint64(number) for number in numbers)), (table, older, newer, latest)
