"""Trace access and counting in kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream_lab.caches.kernels.fast_division import quotient

#: The counts per kind of data, in the order of a row of uint64.
COLUMNS = ("references", "byte_count", "accesses", "misses")

_BYTES, _ACCESSES, _MISSES = (np.uint64(8 * k) for k in range(1, 4))
_ROW = np.uint64(5)  # log2 of 32 bytes


class Trace(NamedTuple):
    """A chunk of a trace; all are uint64.

    Attributes
    ----------
    addresses
        Address of the references' addresses, uint64.
    kinds, lengths
        Addresses of their kinds and lengths, uint8.
    kind_step, length_step
        1, or 0 if all references share one value.
    """

    addresses: np.uint64
    kinds: np.uint64
    kind_step: np.uint64
    lengths: np.uint64
    length_step: np.uint64


@device
def lines_of(trace, i, line_size):
    """Load reference i: the first and last line that it touches, its length, its kind."""
    begin = load(np.uint64, trace.addresses + (i << SHIFT_64))
    length = np.uint64(load(np.uint8, trace.lengths + i * trace.length_step))
    kind = np.uint64(load(np.uint8, trace.kinds + i * trace.kind_step))
    first = quotient(begin, line_size)
    return first, quotient(begin + length - ONE_U64, line_size), length, kind


@device
def first_line(trace, i, line_size):
    """The first line that reference i touches."""
    return quotient(load(np.uint64, trace.addresses + (i << SHIFT_64)), line_size)


@device
def count_reference(counts, kind, length, accesses):
    """Count a reference and its line accesses."""
    row = counts + (kind << _ROW)
    store(row, load(np.uint64, row) + ONE_U64)
    store(row + _BYTES, load(np.uint64, row + _BYTES) + length)
    store(row + _ACCESSES, load(np.uint64, row + _ACCESSES) + accesses)


@device
def count_misses(counts, kind, misses):
    """Count misses."""
    at = counts + (kind << _ROW) + _MISSES
    store(at, load(np.uint64, at) + misses)
