"""Direct-mapped caches: a line has one place."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.simd import load, store
from raystream.lab.caches.kernels.fast_division import quotient
from raystream.lab.caches.kernels.trace_access import lines_of, note_misses, note_reference

__all__ = ["run_direct"]

_ONE = np.uint64(1)
_NUMBER = np.uint64(3)  # eight bytes, as a shift


@kernel
def run_direct(trace, count, line_size, set_count, held, counts):
    """Take a chunk through a direct-mapped cache.

    Parameters
    ----------
    trace : Trace
    count : uint64
        References in the chunk.
    line_size, set_count : Divisor
    held : uint64
        Address of the cache: the line in each set, plus one; 0 for none. Read and written.
    counts : uint64
        Address of a row for each kind, see `trace.COLUMNS`. Read and written.
    """
    for i in range(count):
        line, last, length, kind = lines_of(trace, np.uint64(i), line_size)
        note_reference(counts, kind, length, last - line + _ONE)
        while line <= last:
            place = line - quotient(line, set_count) * set_count.number
            at = held + (place << _NUMBER)
            line += _ONE
            # Without a branch: whether it hits is hard to foresee.
            note_misses(counts, kind, np.uint64(load(np.uint64, at) != line))
            store(at, line)
