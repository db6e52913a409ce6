"""Simulate caches of many ways: a hash table finds lines, and a ring per set keeps LRU order.

Each set owns one slot per way. Its slots form a ring from the most to the least recently used,
which precedes the most recent: a new line takes that slot, and the ring rotates by one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, store
from raystream_lab.caches.kernels.fast_division import quotient
from raystream_lab.caches.kernels.hash_table import home_of
from raystream_lab.caches.kernels.trace_access import count_misses, count_reference, lines_of

_NONE = np.uint32(0)
_SLOT = np.uint64(2)  # log2 of 4 bytes


class Rings(NamedTuple):
    """The cache; all are uint64.

    Attributes
    ----------
    table
        Address of the hash table, uint32: slot numbers plus one, or 0. At least half empty.
    shift, mask
        See `home_of`; size of the table minus one.
    keys
        Address of the line in each slot plus one, uint64; 0 if empty.
    older, newer
        Addresses of each slot's neighbours in its ring, uint32.
    latest
        Address of each set's most recently used slot, uint32.
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
    return load(np.uint64, rings.keys + (slot << SHIFT_64))


@device
def _place_of(rings, key):
    """The table entry of a key, or the empty entry where it belongs."""
    place = home_of(key, rings.shift)
    while True:
        slot = _at(rings.table, place)
        if slot == ZERO_U64 or _key(rings, slot - ONE_U64) == key:
            return place
        place = (place + ONE_U64) & rings.mask


@device
def _remove(rings, place):
    """Empty an entry, and move displaced entries back."""
    other = place
    while True:
        other = (other + ONE_U64) & rings.mask
        slot = _at(rings.table, other)
        if slot == ZERO_U64:
            break
        way = (other - home_of(_key(rings, slot - ONE_U64), rings.shift)) & rings.mask
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
    """Replace the key of a slot."""
    former = _key(rings, slot)
    if former != ZERO_U64:
        _remove(rings, _place_of(rings, former))
    store(rings.keys + (slot << SHIFT_64), key)
    _put(rings.table, _place_of(rings, key), slot + ONE_U64)


@device
def _touch(rings, ring, key):
    """Make a key the most recent of its ring; returns 1 if it is new."""
    latest = _at(rings.latest, ring)
    if _key(rings, latest) == key:
        return ZERO_U64
    slot = _at(rings.table, _place_of(rings, key))
    is_new = slot == ZERO_U64
    if is_new:
        slot = _at(rings.newer, latest)  # the least recently used
        _replace(rings, slot, key)
    else:
        slot -= ONE_U64
        if slot != _at(rings.newer, latest):
            _refresh(rings, slot, latest)
    _put(rings.latest, ring, slot)
    return np.uint64(is_new)


@kernel
def run_linked(trace, count, line_size, set_count, rings, counts):
    """Simulate a chunk of a trace in a set-associative LRU cache.

    Parameters
    ----------
    trace : Trace
    count : uint64
        References in the chunk.
    line_size, set_count : Divisor
    rings : Rings
        Its arrays are updated.
    counts : uint64
        Address of a row per kind; see `trace_access.COLUMNS`. Updated.
    """
    for i in range(count):
        line, last, length, kind = lines_of(trace, np.uint64(i), line_size)
        count_reference(counts, kind, length, last - line + ONE_U64)
        while line <= last:
            ring = line - quotient(line, set_count) * set_count.number
            line += ONE_U64
            count_misses(counts, kind, _touch(rings, ring, line))
