"""Compute exact LRU stack distances of a trace.

The distance of an access is the number of other lines accessed since the last access to its line.
Each line's last access sets a bit on a time line: the distance is the number of bits set after it.
A hash table finds the last access. When the time line is full, the set bits are compacted to its
start; repeated accesses to one line take no time.

References
----------
Mattson, Gecsei, Slutz and Traiger, "Evaluation techniques for storage hierarchies", IBM Systems
Journal 9(2), 1970. Bennett and Kruskal, "LRU stack processing", IBM Journal of Research and
Development 19(4), 1975, introduced the time line and its sums.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, prefetch, store
from raystream_lab.caches.kernels.hash_table import home_of
from raystream_lab.caches.kernels.ranked_bits import clear_bit, count_after, count_before, set_bit
from raystream_lab.caches.kernels.trace_access import (
    count_misses,
    count_reference,
    first_line,
    lines_of,
)

_ENTRY = np.uint64(4)  # log2 of 16 bytes
_AHEAD = np.uint64(12)  # prefetch distance, in references
_TIME = np.uint64(8)  # offset of the time in an entry


class Latest(NamedTuple):
    """The hash table of each line's last access; all are uint64.

    Attributes
    ----------
    entries
        Address of pairs of uint64: a line plus one (0 if empty), and its last access time.
    shift, mask
        See `home_of`; size of the table minus one.
    limit
        Maximum number of lines: half of its size.
    """

    entries: np.uint64
    shift: np.uint64
    mask: np.uint64
    limit: np.uint64


class Clock(NamedTuple):
    """The state that is kept between chunks; all are uint64.

    Attributes
    ----------
    state
        Address of three uint64: the time; the number of lines in the table; the last line plus one.
    end
        The end of the time line.
    """

    state: np.uint64
    end: np.uint64


class Histogram(NamedTuple):
    """Counts by distance, a row for each kind of data; all are uint64.

    Attributes
    ----------
    counts
        Address of the rows, uint64.
    length
        Length of a row: at least `Latest.limit`.
    """

    counts: np.uint64
    length: np.uint64


@device
def _entry_of(latest, key):
    """Address of a key's entry, or of the empty entry where it belongs."""
    place = home_of(key, latest.shift)
    while True:
        entry = latest.entries + (place << _ENTRY)
        found = load(np.uint64, entry)
        if found in (key, ZERO_U64):
            return entry
        place = (place + ONE_U64) & latest.mask


@device
def _count_distance(histogram, kind, distance):
    at = histogram.counts + ((kind * histogram.length + distance) << SHIFT_64)
    store(at, load(np.uint64, at) + ONE_U64)


@device
def _prefetch(trace, i, count, line_size, latest):
    """Prefetch the table entry of a reference's first line."""
    if i < count:
        key = first_line(trace, i, line_size) + ONE_U64
        prefetch(latest.entries + (home_of(key, latest.shift) << _ENTRY))


@kernel
def run_distances(trace, start, count, line_size, latest, bits, clock, histogram, counts):
    """Count the distances of a chunk, starting at reference `start`.

    Parameters
    ----------
    trace : Trace
    start, count : uint64
    line_size : Divisor
    latest : Latest
    bits : RankedBits
    clock : Clock
        The arrays of all three are updated.
    histogram : Histogram
    counts : uint64
        Address of a row per kind; see `trace_access.COLUMNS`. Misses are first accesses.

    Returns
    -------
    int
        `count`, or the first reference that needs a larger table or time line.
    """
    now = load(np.uint64, clock.state)
    known = load(np.uint64, clock.state + np.uint64(8))
    former = load(np.uint64, clock.state + np.uint64(16))
    i = start
    while i < count:
        _prefetch(trace, i + _AHEAD, count, line_size, latest)
        line, last, length, kind = lines_of(trace, i, line_size)
        touched = last - line + ONE_U64
        if now + touched > clock.end or known + touched > latest.limit:
            break
        count_reference(counts, kind, length, touched)
        while line <= last:
            line += ONE_U64
            if line == former:
                _count_distance(histogram, kind, ZERO_U64)
                continue
            former = line
            entry = _entry_of(latest, line)
            if load(np.uint64, entry) == line:
                time = load(np.uint64, entry + _TIME)
                _count_distance(histogram, kind, count_after(bits, time, now))
                clear_bit(bits, time)
            else:
                store(entry, line)
                known += ONE_U64
                count_misses(counts, kind, ONE_U64)
            set_bit(bits, now)
            store(entry + _TIME, now)
            now += ONE_U64
        i += ONE_U64
    store(clock.state, now)
    store(clock.state + np.uint64(8), known)
    store(clock.state + np.uint64(16), former)
    return i


@kernel
def move_times(latest, words, before):
    """Replace each line's time by its rank among the set bits.

    Parameters
    ----------
    latest : Latest
        Its times are updated.
    words, before : uint64
        Addresses of the bitmap's words, and of the number of bits set before each word.
    """
    for place in range(latest.mask + ONE_U64):
        entry = latest.entries + (np.uint64(place) << _ENTRY)
        if load(np.uint64, entry) != ZERO_U64:
            time = load(np.uint64, entry + _TIME)
            at = (time >> np.uint64(6)) << SHIFT_64
            rank = load(np.uint64, before + at) + count_before(load(np.uint64, words + at), time)
            store(entry + _TIME, rank)


@kernel
def move_entries(former, latest):
    """Rehash a table's entries into a larger, empty table.

    Parameters
    ----------
    former, latest : Latest
    """
    for place in range(former.mask + ONE_U64):
        entry = former.entries + (np.uint64(place) << _ENTRY)
        key = load(np.uint64, entry)
        if key != ZERO_U64:
            to = _entry_of(latest, key)
            store(to, key)
            store(to + _TIME, load(np.uint64, entry + _TIME))
