"""Set-associative caches of few ways: a set is a short list, the latest line first."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, store
from raystream.lab.caches.kernels.fast_division import quotient
from raystream.lab.caches.kernels.trace_access import lines_of, note_misses, note_reference

__all__ = ["run_sets"]

_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_NUMBER = np.uint64(3)  # eight bytes, as a shift


@device
def _to_front(begin, end, key):
    """Move a key to the front of a set, the last one out if it is new; 1 if it is new."""
    at = begin
    carried = key
    while at != end:
        found = load(np.uint64, at)
        store(at, carried)
        if found == key:
            return _ZERO
        carried = found
        at += np.uint64(8)
    return _ONE


@kernel
def run_sets(trace, count, line_size, set_count, ways, held, counts):
    """Take a chunk through a set-associative cache that drops the least recently used line.

    Parameters
    ----------
    trace : Trace
    count : uint64
        References in the chunk.
    line_size, set_count : Divisor
    ways : uint64
    held : uint64
        Address of the cache: the lines of each set by latest use, plus one; 0 for none. Read
        and written.
    counts : uint64
        Address of a row for each kind, see `trace.COLUMNS`. Read and written.
    """
    row = ways << _NUMBER
    for i in range(count):
        line, last, length, kind = lines_of(trace, np.uint64(i), line_size)
        note_reference(counts, kind, length, last - line + _ONE)
        while line <= last:
            place = line - quotient(line, set_count) * set_count.number
            begin = held + place * row
            line += _ONE
            note_misses(counts, kind, _to_front(begin, begin + row, line))
