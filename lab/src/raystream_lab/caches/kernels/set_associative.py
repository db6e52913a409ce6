"""Simulate set-associative caches of few ways: each set is a short list in LRU order."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, store
from raystream_lab.caches.kernels.fast_division import quotient
from raystream_lab.caches.kernels.trace_access import count_misses, count_reference, lines_of


@device
def _to_front(begin, end, key):
    """Move a key to the front of a set; if it is new, evict the last one and return 1."""
    at = begin
    carried = key
    while at != end:
        found = load(np.uint64, at)
        store(at, carried)
        if found == key:
            return ZERO_U64
        carried = found
        at += np.uint64(8)
    return ONE_U64


@kernel
def run_sets(trace, count, line_size, set_count, ways, held, counts):
    """Simulate a chunk of a trace in a set-associative LRU cache.

    Parameters
    ----------
    trace : Trace
    count : uint64
        References in the chunk.
    line_size, set_count : Divisor
    ways : uint64
    held : uint64
        Address of the cache: the lines of each set in LRU order, plus one; 0 if empty. Updated.
    counts : uint64
        Address of a row per kind; see `trace_access.COLUMNS`. Updated.
    """
    row = ways << SHIFT_64
    for i in range(count):
        line, last, length, kind = lines_of(trace, np.uint64(i), line_size)
        count_reference(counts, kind, length, last - line + ONE_U64)
        while line <= last:
            place = line - quotient(line, set_count) * set_count.number
            begin = held + place * row
            line += ONE_U64
            count_misses(counts, kind, _to_front(begin, begin + row, line))
