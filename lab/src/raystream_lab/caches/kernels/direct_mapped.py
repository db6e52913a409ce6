"""Simulate direct-mapped caches."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64
from raystream.jit.cpu import kernel
from raystream.jit.simd import load, store
from raystream_lab.caches.kernels.fast_division import quotient
from raystream_lab.caches.kernels.trace_access import count_misses, count_reference, lines_of


@kernel
def run_direct(trace, count, line_size, set_count, held, counts):
    """Simulate a chunk of a trace in a direct-mapped cache.

    Parameters
    ----------
    trace : Trace
    count : uint64
        References in the chunk.
    line_size, set_count : Divisor
    held : uint64
        Address of the cache: the line in each set plus one, 0 if empty. Updated.
    counts : uint64
        Address of a row per kind; see `trace_access.COLUMNS`. Updated.
    """
    for i in range(count):
        line, last, length, kind = lines_of(trace, np.uint64(i), line_size)
        count_reference(counts, kind, length, last - line + ONE_U64)
        while line <= last:
            place = line - quotient(line, set_count) * set_count.number
            at = held + (place << SHIFT_64)
            line += ONE_U64
            # Branchless: hits are hard to predict.
            count_misses(counts, kind, np.uint64(load(np.uint64, at) != line))
            store(at, line)
