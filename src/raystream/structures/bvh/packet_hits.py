"""All hits of a packet's rays: collected as they are found, then sorted by ray, t and prim_id.

Hits are appended 16 lanes at a time, with the number of their ray. Where their order matters,
that is the number in the packet: when it is done, they are counted by ray, moved to their
ray's rows, and sorted there.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import stay_out_of_line
from raystream.jit.simd import compress, count_bits, f32x16, i32x16, lane_bits, load, store
from raystream.structures.bvh.packet_rays import FACTOR, world_lanes

__all__ = [
    "ADDRESSES",
    "CAPACITY",
    "COLLECTOR_BYTES",
    "COUNT_AT",
    "ENDS_BYTES",
    "FIRSTS_AT",
    "IN_WORLD_AT",
    "LANES_AT",
    "collect",
    "has_room",
    "sort_packet",
]

# A collector: how many hits there are, how many there is room for, and the addresses of t, u,
# v, prim_id and ray of those in the order in which they were found, and of t, u, v and prim_id
# in the order of rays. Then 0, 1, 2 ... for 16 lanes, the number of each group's first ray,
# and whether t is to be in world direction lengths.
COUNT_AT = np.uint64(0)
CAPACITY = np.uint64(8)
ADDRESSES = np.uint64(16)
_FOUND_T, _FOUND_U, _FOUND_V, _FOUND_PRIM, _FOUND_RAY = (np.uint64(16 + 8 * k) for k in range(5))
_T, _U, _V, _PRIM = (np.uint64(56 + 8 * k) for k in range(4))
LANES_AT = np.uint64(128)
FIRSTS_AT = np.uint64(192)
IN_WORLD_AT = np.uint64(256)
COLLECTOR_BYTES = 264

#: Bytes that sorting a packet's hits needs for its rays.
ENDS_BYTES = 2 * 256 * 8

_LANE = np.uint64(4)
_LANES = np.uint64(16)
_RAYS = np.uint64(256)
_LENGTHS = np.uint64(256 * 8)
_U0 = np.uint64(0)
_U1 = np.uint64(1)

#: Rows of more hits are sorted by a heap.
_LONG = np.uint64(24)


@device
def has_room(hits):
    """Whether no hit of the packet was left out."""
    return load(np.uint64, hits + COUNT_AT) + _LANES <= load(np.uint64, hits + CAPACITY)


@device
def collect(hits, taken, t, u, v, prim_id, rays, group):
    """Append the hits of these lanes; without room they are only counted.

    Parameters
    ----------
    hits : uint64
        Address of a collector.
    taken : mask16
    t, u, v : f32x16
    prim_id : i32x16
    rays, group : uint64
        Address and number of the group.
    """
    count = load(np.uint64, hits + COUNT_AT)
    if count + _LANES <= load(np.uint64, hits + CAPACITY):
        at = count * _LANE
        if load(np.uint64, hits + IN_WORLD_AT) != _U0:
            t = world_lanes(t, load(f32x16, rays + FACTOR))
        store(load(np.uint64, hits + _FOUND_T) + at, compress(taken, t))
        store(load(np.uint64, hits + _FOUND_U) + at, compress(taken, u))
        store(load(np.uint64, hits + _FOUND_V) + at, compress(taken, v))
        store(load(np.uint64, hits + _FOUND_PRIM) + at, prim_id)
        numbers = load(i32x16, hits + LANES_AT) + load(np.int32, hits + FIRSTS_AT + group * _LANE)
        store(load(np.uint64, hits + _FOUND_RAY) + at, compress(taken, numbers))
    store(hits + COUNT_AT, count + count_bits(lane_bits(taken)))


@device
def _goes_before(rows, row, t, prim_id):
    """Whether the hit of a row comes before another one."""
    other = load(np.float32, load(np.uint64, rows + _T) + row * _LANE)
    if other != t:
        return other < t
    return load(np.int32, load(np.uint64, rows + _PRIM) + row * _LANE) < prim_id


@device
def _put(rows, row, t, u, v, prim_id):
    at = row * _LANE
    store(load(np.uint64, rows + _T) + at, t)
    store(load(np.uint64, rows + _U) + at, u)
    store(load(np.uint64, rows + _V) + at, v)
    store(load(np.uint64, rows + _PRIM) + at, prim_id)


@device
def _take(rows, row):
    at = row * _LANE
    return (
        load(np.float32, load(np.uint64, rows + _T) + at),
        load(np.float32, load(np.uint64, rows + _U) + at),
        load(np.float32, load(np.uint64, rows + _V) + at),
        load(np.int32, load(np.uint64, rows + _PRIM) + at),
    )


@device
def _copy(rows, to, source):
    t, u, v, prim_id = _take(rows, source)
    _put(rows, to, t, u, v, prim_id)


@device_call
def _sift_down(rows, first, count, hole, t, u, v, prim_id):
    """Put a hit into a heap whose root is its last hit, starting at an empty place."""
    stay_out_of_line()
    while True:
        child = hole + hole + _U1
        if child >= count:
            break
        if child + _U1 < count:
            other_t, _, _, other_id = _take(rows, first + child + _U1)
            if _goes_before(rows, first + child, other_t, other_id):
                child += _U1
        child_t, _, _, child_id = _take(rows, first + child)
        if not (t < child_t or (t == child_t and prim_id < child_id)):
            break
        _copy(rows, first + hole, first + child)
        hole = child
    _put(rows, first + hole, t, u, v, prim_id)


@device_call
def _sort_long(rows, first, count):
    stay_out_of_line()
    hole = count // np.uint64(2)
    while hole != _U0:
        hole -= _U1
        t, u, v, prim_id = _take(rows, first + hole)
        _sift_down(rows, first, count, hole, t, u, v, prim_id)
    last = count - _U1
    while last != _U0:
        t, u, v, prim_id = _take(rows, first + last)
        _copy(rows, first + last, first)
        _sift_down(rows, first, last, _U0, t, u, v, prim_id)
        last -= _U1


@device
def _insert(rows, first, row, t, u, v, prim_id):
    """Put a hit into its place among the sorted rows first to row."""
    while row > first and not _goes_before(rows, row - _U1, t, prim_id):
        _copy(rows, row, row - _U1)
        row -= _U1
    _put(rows, row, t, u, v, prim_id)


@device_call
def _drop_twins(rows, first, count, to):
    """Move a ray's sorted hits to row `to`, each triangle once; returns how many are left.

    A triangle that is in several leaves was hit several times, with the same bits.
    """
    stay_out_of_line()
    kept = _U0
    for k in range(count):
        t, u, v, prim_id = _take(rows, first + k)
        if (
            kept != _U0
            and load(np.int32, load(np.uint64, rows + _PRIM) + (to + kept - _U1) * _LANE) == prim_id
        ):
            continue
        _put(rows, to + kept, t, u, v, prim_id)
        kept += _U1
    return kept


@device_call
def sort_packet(hits, ends, used, lists_twice):
    """Bring a packet's hits into the order of its rays, each ray's by t, then prim_id.

    Parameters
    ----------
    hits : uint64
        Address of a collector that had room.
    ends : uint64
        Address of `ENDS_BYTES` bytes: written, 256 uint64, the row after each ray's last one.
    used : uint64
        Rows in use already.
    lists_twice : bool
        Whether a triangle may have been found more than once.

    Returns
    -------
    uint64
        Rows in use now.
    """
    stay_out_of_line()
    count = load(np.uint64, hits + COUNT_AT)
    rays = load(np.uint64, hits + _FOUND_RAY)
    for ray in range(_RAYS):
        store(ends + ray * np.uint64(8), _U0)
    for k in range(count):
        at = ends + np.uint64(load(np.int32, rays + k * _LANE)) * np.uint64(8)
        store(at, load(np.uint64, at) + _U1)
    row = used
    for ray in range(_RAYS):
        at = ends + ray * np.uint64(8)
        ray_count = load(np.uint64, at)
        store(at, row)
        store(at + _LENGTHS, ray_count)
        row += ray_count
    for k in range(count):
        at = k * _LANE
        t = load(np.float32, load(np.uint64, hits + _FOUND_T) + at)
        u = load(np.float32, load(np.uint64, hits + _FOUND_U) + at)
        v = load(np.float32, load(np.uint64, hits + _FOUND_V) + at)
        prim_id = load(np.int32, load(np.uint64, hits + _FOUND_PRIM) + at)
        place = ends + np.uint64(load(np.int32, rays + at)) * np.uint64(8)
        row = load(np.uint64, place)
        _put(hits, row, t, u, v, prim_id)
        store(place, row + _U1)
    to = used
    first = used
    for ray in range(_RAYS):
        at = ends + ray * np.uint64(8)
        ray_count = load(np.uint64, at + _LENGTHS)
        if ray_count > _LONG:
            _sort_long(hits, first, ray_count)
        else:
            for k in range(_U1, ray_count):
                t, u, v, prim_id = _take(hits, first + k)
                _insert(hits, first, first + k, t, u, v, prim_id)
        if lists_twice:
            to += _drop_twins(hits, first, ray_count, to)
        else:
            to += ray_count
        first += ray_count
        store(at, to)
    return to
