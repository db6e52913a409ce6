"""Exact LRU stack distances of a trace.

The distance of an access is the number of other lines that were accessed since the latest access
to its line. Each line's latest access has a mark on a time line: the distance is the number of
marks after it. A hash table finds that access. When the time line ends, the marks are moved
together at its beginning; lines that are accessed again and again take no time.

References
----------
Mattson, Gecsei, Slutz and Traiger, "Evaluation techniques for storage hierarchies", IBM Systems
Journal 9(2), 1970. Bennett and Kruskal, "LRU stack processing", IBM Journal of Research and
Development 19(4), 1975, have the time line and its sums.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, prefetch, store
from raystream.lab.caches.kernels.hash_table import home_of
from raystream.lab.caches.kernels.ranked_bits import mark, marks_after, marks_before, unmark
from raystream.lab.caches.kernels.trace_access import (
    first_line,
    lines_of,
    note_misses,
    note_reference,
)

__all__ = ["Clock", "Histogram", "Latest", "move_entries", "move_times", "run_distances"]

_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_NUMBER = np.uint64(3)  # eight bytes, as a shift
_ENTRY = np.uint64(4)  # sixteen bytes, as a shift
_AHEAD = np.uint64(12)  # references that it takes for an entry to come from memory
_TIME = np.uint64(8)  # where in an entry the time is


class Latest(NamedTuple):
    """The hash table of each line's latest access; all are uint64.

    Attributes
    ----------
    entries
        Address of pairs of uint64: a line plus one, or 0 for none; and when it was accessed.
    shift, mask
        See `home_of`; places of the table, less one.
    limit
        Lines that it may hold: no more than half of its places.
    """

    entries: np.uint64
    shift: np.uint64
    mask: np.uint64
    limit: np.uint64


class Clock(NamedTuple):
    """Where the kernel keeps what it must know in the next chunk; all are uint64.

    Attributes
    ----------
    state
        Address of three uint64: the time; lines in the table; the latest line, plus one.
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
    """Address of a key's entry, or of the empty one where it belongs."""
    place = home_of(key, latest.shift)
    while True:
        entry = latest.entries + (place << _ENTRY)
        found = load(np.uint64, entry)
        if found in (key, _ZERO):
            return entry
        place = (place + _ONE) & latest.mask


@device
def _count_distance(histogram, kind, distance):
    at = histogram.counts + ((kind * histogram.length + distance) << _NUMBER)
    store(at, load(np.uint64, at) + _ONE)


@device
def _look_ahead(trace, i, count, line_size, latest):
    """Ask for the entry of a reference's first line: it takes long to come from memory."""
    if i < count:
        key = first_line(trace, i, line_size) + _ONE
        prefetch(latest.entries + (home_of(key, latest.shift) << _ENTRY))


@kernel
def run_distances(trace, start, count, line_size, latest, marks, clock, histogram, counts):
    """Count the distances of a chunk from reference `start` on.

    Parameters
    ----------
    trace : Trace
    start, count : uint64
    line_size : Divisor
    latest : Latest
    marks : Marks
    clock : Clock
        The arrays of all three are read and written.
    histogram : Histogram
    counts : uint64
        Address of a row for each kind, see `trace.COLUMNS`. Misses are first accesses.

    Returns
    -------
    int
        `count`, or the reference that has to wait until there is more room.
    """
    now = load(np.uint64, clock.state)
    known = load(np.uint64, clock.state + np.uint64(8))
    former = load(np.uint64, clock.state + np.uint64(16))
    i = start
    while i < count:
        _look_ahead(trace, i + _AHEAD, count, line_size, latest)
        line, last, length, kind = lines_of(trace, i, line_size)
        touched = last - line + _ONE
        if now + touched > clock.end or known + touched > latest.limit:
            break
        note_reference(counts, kind, length, touched)
        while line <= last:
            line += _ONE
            if line == former:
                _count_distance(histogram, kind, _ZERO)
                continue
            former = line
            entry = _entry_of(latest, line)
            if load(np.uint64, entry) == line:
                time = load(np.uint64, entry + _TIME)
                _count_distance(histogram, kind, marks_after(marks, time, now))
                unmark(marks, time)
            else:
                store(entry, line)
                known += _ONE
                note_misses(counts, kind, _ONE)
            mark(marks, now)
            store(entry + _TIME, now)
            now += _ONE
        i += _ONE
    store(clock.state, now)
    store(clock.state + np.uint64(8), known)
    store(clock.state + np.uint64(16), former)
    return i


@kernel
def move_times(latest, words, before):
    """Give each line the rank of its time among the marks instead of the time.

    Parameters
    ----------
    latest : Latest
        Its times are read and written.
    words, before : uint64
        Addresses of the marks' words, and of how many marks are before each word.
    """
    for place in range(latest.mask + _ONE):
        entry = latest.entries + (np.uint64(place) << _ENTRY)
        if load(np.uint64, entry) != _ZERO:
            time = load(np.uint64, entry + _TIME)
            at = (time >> np.uint64(6)) << _NUMBER
            rank = load(np.uint64, before + at) + marks_before(load(np.uint64, words + at), time)
            store(entry + _TIME, rank)


@kernel
def move_entries(former, latest):
    """Copy the entries of a table into a larger, empty one.

    Parameters
    ----------
    former, latest : Latest
    """
    for place in range(former.mask + _ONE):
        entry = former.entries + (np.uint64(place) << _ENTRY)
        key = load(np.uint64, entry)
        if key != _ZERO:
            to = _entry_of(latest, key)
            store(to, key)
            store(to + _TIME, load(np.uint64, entry + _TIME))
