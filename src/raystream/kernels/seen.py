"""The triangles that a ray has hit: for structures which list a triangle more than once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load, store

__all__ = ["FULL", "LEAST_ROOM", "NEW", "OLD", "SeenSet", "clear_seen", "mark_seen"]

#: What `mark_seen` answers.
OLD, NEW, FULL = np.uint64(0), np.uint64(1), np.uint64(2)

#: Places of the smallest set: a power of two.
LEAST_ROOM = np.uint64(64)

_FREE = np.int32(-1)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # a number's four bytes, as a shift

#: Spreads the bits of a number over the upper half of a product: 2**64 / golden ratio.
_SPREAD = np.uint64(0x9E3779B97F4A7C15)
_UPPER = np.uint64(32)


class SeenSet(NamedTuple):
    """A set of triangles in memory; the caller keeps it alive.

    Attributes
    ----------
    table : uint64
        Address of `room` + 1 int32: the places, and how many of them are taken.
    room : uint64
        Places, a power of two; half as many triangles can be added. 0 for a set that remembers
        nothing, and needs no memory.
    """

    table: np.uint64
    room: np.uint64


@device
def clear_seen(seen):
    """Empty a set."""
    if seen.room != _NONE:
        for place in range(seen.room):
            store(seen.table + (place << _WORD), _FREE)
        store(seen.table + (seen.room << _WORD), np.int32(0))


@device
def mark_seen(seen, prim_id):
    """Add a triangle to a set.

    Parameters
    ----------
    seen : SeenSet
    prim_id : int32

    Returns
    -------
    uint64
        `NEW`, `OLD` if it was there already, or `FULL` if there is no room: then the ray
        has to be traced again with a larger set.
    """
    table, room = seen.table, seen.room
    if room == _NONE:
        return NEW
    place = (np.uint64(prim_id) * _SPREAD) >> _UPPER
    while True:
        at = table + ((place & (room - _ONE)) << _WORD)
        found = load(np.int32, at)
        if found == prim_id:
            return OLD
        if found == _FREE:
            break
        place += _ONE
    count_at = table + (room << _WORD)
    count = np.uint64(load(np.int32, count_at)) + _ONE
    if count + count > room:
        return FULL
    store(count_at, np.int32(count))
    store(at, prim_id)
    return NEW
