"""Caches of many ways: a hash table finds a line, a ring for each set keeps their order.

Each set owns as many slots as it has ways. Its slots are linked in a ring, from the latest used
to the least recently used, which is before the latest: a new line takes its slot, and the ring
turns by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, store
from raystream.lab.caches.kernels.fast_division import quotient
from raystream.lab.caches.kernels.hash_table import home_of
from raystream.lab.caches.kernels.trace_access import lines_of, note_misses, note_reference

__all__ = ["Rings", "run_linked"]

_NONE = np.uint32(0)
_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_NUMBER = np.uint64(3)  # eight bytes, as a shift
_SLOT = np.uint64(2)  # four bytes, as a shift


class Rings(NamedTuple):
    """The cache; all are uint64.

    Attributes
    ----------
    table
        Address of the hash table: in each place the number of a slot plus one, uint32, or 0.
        At least half of the places are empty.
    shift, mask
        See `home_of`; places of the table, less one.
    keys
        Address of the line in each slot, plus one, uint64; 0 for none.
    older, newer
        Addresses of each slot's neighbours in its ring, uint32.
    latest
        Address of each set's latest slot, uint32.
    """

    table: np.uint64
    shift: np.uint64
    mask: np.uint64
    keys: np.uint64
    older: np.uint64
    newer: np.uint64
    latest: np.uint64


@device
def _at(numbers, i):
    """Number i of an array of uint32, as a uint64."""
    return np.uint64(load(np.uint32, numbers + (i << _SLOT)))


@device
def _put(numbers, i, number):
    store(numbers + (i << _SLOT), np.uint32(number))


@device
def _key(rings, slot):
    return load(np.uint64, rings.keys + (slot << _NUMBER))


@device
def _place_of(rings, key):
    """The place in the table that has a key, or the empty place where it belongs."""
    place = home_of(key, rings.shift)
    while True:
        slot = _at(rings.table, place)
        if slot == _ZERO or _key(rings, slot - _ONE) == key:
            return place
        place = (place + _ONE) & rings.mask


@device
def _take_out(rings, place):
    """Empty a place, and move up what was put behind it for want of room."""
    other = place
    while True:
        other = (other + _ONE) & rings.mask
        slot = _at(rings.table, other)
        if slot == _ZERO:
            break
        way = (other - home_of(_key(rings, slot - _ONE), rings.shift)) & rings.mask
        if way >= ((other - place) & rings.mask):
            _put(rings.table, place, slot)
            place = other
    _put(rings.table, place, _NONE)


@device
def _refresh(rings, slot, latest):
    """Move a slot to the head of its ring."""
    older, newer = _at(rings.older, slot), _at(rings.newer, slot)
    _put(rings.older, newer, older)
    _put(rings.newer, older, newer)
    oldest = _at(rings.newer, latest)
    _put(rings.older, oldest, slot)
    _put(rings.newer, slot, oldest)
    _put(rings.older, slot, latest)
    _put(rings.newer, latest, slot)


@device
def _replace(rings, slot, key):
    """Put a new key into a slot, whatever is there goes."""
    former = _key(rings, slot)
    if former != _ZERO:
        _take_out(rings, _place_of(rings, former))
    store(rings.keys + (slot << _NUMBER), key)
    _put(rings.table, _place_of(rings, key), slot + _ONE)


@device
def _touch(rings, ring, key):
    """Make a key the latest of its ring; 1 if it is new."""
    latest = _at(rings.latest, ring)
    if _key(rings, latest) == key:
        return _ZERO
    slot = _at(rings.table, _place_of(rings, key))
    is_new = slot == _ZERO
    if is_new:
        slot = _at(rings.newer, latest)  # the least recently used
        _replace(rings, slot, key)
    else:
        slot -= _ONE
        if slot != _at(rings.newer, latest):
            _refresh(rings, slot, latest)
    _put(rings.latest, ring, slot)
    return np.uint64(is_new)


@kernel
def run_linked(trace, count, line_size, set_count, rings, counts):
    """Take a chunk through a cache that drops the least recently used line of a set.

    Parameters
    ----------
    trace : Trace
    count : uint64
        References in the chunk.
    line_size, set_count : Divisor
    rings : Rings
        Its arrays are read and written.
    counts : uint64
        Address of a row for each kind, see `trace.COLUMNS`. Read and written.
    """
    for i in range(count):
        line, last, length, kind = lines_of(trace, np.uint64(i), line_size)
        note_reference(counts, kind, length, last - line + _ONE)
        while line <= last:
            ring = line - quotient(line, set_count) * set_count.number
            line += _ONE
            note_misses(counts, kind, _touch(rings, ring, line))
