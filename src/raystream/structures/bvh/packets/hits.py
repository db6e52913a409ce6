"""All hits of a packet's rays: collected, then sorted by ray, t and prim_id.

Hits are appended 16 lanes at a time, with the index of their ray. To sort them, that is the index
in the packet: when the packet is done, hits are counted by ray, scattered to the ray's rows, and
sorted there. Those of rays in flight are, too, with the index in their call.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import compress, i32x16, lane_numbers, load, mask_bits, popcount, store
from raystream.jit.views import view
from raystream.kernels.search import ROW_SHIFT, get_hit, is_before, put_hit, sort_hits
from raystream.structures.bvh.packets.rays import PACKET_RAYS

#: Addresses of buffers: hits in the order of discovery, sorted hits, their rays and the ends of the
#: rays' rows; then the capacity in hits, and what is in use: hits, and rays if hits are sorted.
_FOUND = np.dtype([("t", "u8"), ("u", "u8"), ("v", "u8"), ("prim_id", "u8"), ("ray", "u8")])
_ROWS = np.dtype([("t", "u8"), ("u", "u8"), ("v", "u8"), ("prim_id", "u8")])
_NUMBERS = "ray_ids", "splits", "capacity", "used", "ray_count"
Buffers = view([("found", _FOUND), ("rows", _ROWS), *((name, "u8") for name in _NUMBERS)])

#: Groups of a packet, or of a block of them.
_MOST_GROUPS = 256

_COLLECTOR = np.dtype(
    [
        ("buffers", "u8"),  # their address
        ("count", "u8"),  # hits
        ("capacity", "u8"),  # of the buffers
        ("is_counting", "u8"),  # whether hits are counted only
        ("in_world", "u8"),  # whether to convert t to world direction lengths
        ("first_rays", "i4", (_MOST_GROUPS, 1)),  # index of each group's first ray
    ]
)
Collector = view(_COLLECTOR)
COLLECTOR_BYTES = _COLLECTOR.itemsize

#: The end of each ray's sorted rows.
_ENDS = np.dtype([("ends", "u8", (PACKET_RAYS, 1))])
Ends = view(_ENDS)
ENDS_BYTES = _ENDS.itemsize

_LANE = np.uint64(4)
_LANES = np.uint64(16)

#: Rays with more hits are sorted by a heap.
_LONG = np.uint64(24)


@device
def has_room(hits):
    """Whether all hits of the packet fit."""
    return hits.count + _LANES <= hits.capacity


@device
def collect(hits, taken, t, u, v, prim_id, g):
    """Append the hits of some lanes; those that do not fit are only counted.

    Parameters
    ----------
    hits : Collector
    taken : mask16
    t, u, v : f32x16
    prim_id : i32x16
    g : uint64
        The index of their group.
    """
    if has_room(hits):
        row, found = hits.count, Buffers(hits.buffers).found
        at = row << ROW_SHIFT
        store(found.t + at, compress(taken, t))
        store(found.u + at, compress(taken, u))
        store(found.v + at, compress(taken, v))
        at = row * _LANE
        store(found.prim_id + at, prim_id)
        store(found.ray + at, compress(taken, lane_numbers(i32x16) + hits.first_rays[g]))
    hits.count += popcount(mask_bits(taken))


@device
def collect_one(hits, t, u, v, prim_id, g, k):
    """The same for a hit of ray k of group g."""
    if has_room(hits):
        found = Buffers(hits.buffers).found
        put_hit(found, hits.count, t, u, v, prim_id)
        store(found.ray + hits.count * _LANE, hits.first_rays[g] + np.int32(k))
    hits.count += ONE_U64


@device
def _insert(rows, first, row, t, u, v, prim_id):
    """Insert a hit into the sorted rows first to row."""
    while row > first:
        other_t, other_u, other_v, other_id = get_hit(rows, row - ONE_U64)
        if not is_before(t, prim_id, other_t, other_id):
            break
        put_hit(rows, row, other_t, other_u, other_v, other_id)
        row -= ONE_U64
    put_hit(rows, row, t, u, v, prim_id)


@device_call
def sort_by_ray(buffers, count, ends, ray_count, used, sorts):
    """Move the hits of rays from the order of discovery to rows, the rays' one after another.

    Parameters
    ----------
    buffers : Buffers
    count : uint64
        Hits, of which `buffers.found` has all.
    ends : uint64
        Address of a uint64 per ray. Written: the end of its rows.
    ray_count : uint64
    used : uint64
        Rows in use before.
    sorts : bool
        Whether each ray's hits are sorted by t and prim_id.

    Returns
    -------
    uint64
        Rows in use now.
    """
    no_inline()
    found, rows, rays = buffers.found, buffers.rows, buffers.found.ray
    for ray in range(ray_count):
        store(ends + (ray << SHIFT_64), ZERO_U64)
    for k in range(count):
        at = ends + (np.uint64(load(np.int32, rays + k * _LANE)) << SHIFT_64)
        store(at, load(np.uint64, at) + ONE_U64)
    row = used
    for ray in range(ray_count):
        at = ends + (ray << SHIFT_64)
        own_count = load(np.uint64, at)
        store(at, row)
        row += own_count
    for k in range(count):
        at = ends + (np.uint64(load(np.int32, rays + k * _LANE)) << SHIFT_64)
        t, u, v, prim_id = get_hit(found, k)
        row = load(np.uint64, at)
        put_hit(rows, row, t, u, v, prim_id)
        store(at, row + ONE_U64)
    first = used
    for ray in range(ray_count if sorts else ZERO_U64):
        end = load(np.uint64, ends + (ray << SHIFT_64))
        if end - first > _LONG:
            sort_hits(rows, first, end - first)
        else:
            for row in range(first + ONE_U64, end):
                t, u, v, prim_id = get_hit(rows, row)
                _insert(rows, first, row, t, u, v, prim_id)
        first = end
    return used + count
