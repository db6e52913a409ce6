"""The rays of a packet: their layout in memory, their order in a batch, and their results.

A packet is 256 rays: a tile of 16 x 16 pixels of an image-shaped batch, or 256 consecutive rays.
It is on the stack, in groups of 16 rays; a group has a vector for each attribute of its rays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    f32x16,
    i32x16,
    load,
    mask_bits,
    maximum,
    minimum,
    select,
    store,
    store_nontemporal,
)
from raystream.jit.views import view
from raystream.kernels.ray import SceneFrame, world_t
from raystream.kernels.ray_source import RaySource

#: Rays of a packet: larger ones share more nodes, but fill the L1 cache.
PACKET_RAYS = 256

GROUPS = np.uint64(PACKET_RAYS // 16)

#: A group. Axes are in world order, except for the shear's. (Arrays over the whole packet would be
#: 1024 bytes apart: loads would wait for stores to other arrays at the same page offset.)
_FIELDS: list[tuple[str, str, tuple[int, ...]]] = [
    ("inv", "f4", (3, 16)),
    ("near", "f4", (3, 16)),
    ("far", "f4", (3, 16)),
    ("origin", "f4", (3, 16)),
    ("shear", "f4", (3, 16)),
    ("t_min", "f4", (16,)),
    ("t", "f4", (16,)),  # t_max, then the nearest hit's
    ("t_active", "f4", (16,)),  # the same for active rays, -inf for others
    ("prim_id", "i4", (16,)),
    ("u", "f4", (16,)),
    ("v", "f4", (16,)),
    ("direction_class", "i4", (16,)),  # octant and largest axis of the direction
    ("t_scale", "f4", (16,)),
    # In groups with a ray that took the slow path into the local frame.
    ("slow_t_scale", "f8", (16,)),
    ("slow_t_offset", "f8", (16,)),
    ("direction", "f4", (3, 16)),
]
GROUP = np.dtype(_FIELDS)
Group = view(GROUP)
#: The same with a lane index.
GroupLanes = view([(name, kind, (*shape, 1)) for name, kind, shape in _FIELDS])

GROUP_BYTES = np.uint64(GROUP.itemsize)
PACKET_BYTES = GROUP.itemsize * PACKET_RAYS // 16

NO_PRIM = np.int32(2**31 - 1)
NO_CLASS = np.int32(-1)

_LARGEST = np.float32(np.finfo(np.float32).max)
_MISS = np.int32(-1)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_LANES = np.uint64(16)
_ALL_LANES = np.uint64(0xFFFF)
_SIDE = np.uint64(16)
_LANE = np.uint64(4)
_LINE_BITS = np.uint64(63)
_ENTRY_BYTES = np.uint64(8)
_COUNT_BITS, _COUNT_MASK = np.uint64(5), np.uint64(31)


class PacketOrder(NamedTuple):
    """Which rays of a batch form a packet.

    Attributes
    ----------
    width : int
        Rays in a row: packets are tiles of 16 x 16 of these rows. 0 for consecutive rays.
    ray_count, packet_count : int
        Of the batch.
    table : int
        Address of a uint64 for each group of 16 of each packet: 32 times the index of its first
        ray, plus the number of its rays. 0 where the width says it.
    """

    width: np.uint64
    ray_count: np.uint64
    packet_count: int
    table: np.uint64

    @classmethod
    def of(cls, shape: tuple[int, ...]) -> PacketOrder:
        """The packets of rays of a shape, whose last two dimensions are an image's."""
        is_image = len(shape) >= 2 and shape[-1] >= int(_SIDE)
        return cls.of_rows(shape[-1] if is_image else 0, math.prod(shape))

    @classmethod
    def of_rows(cls, width: int, ray_count: int) -> PacketOrder:
        """Tiles of rows of `width` rays, the last of which may be shorter; 256 in a row for 0."""
        side = int(_SIDE)
        if width == 0:
            packet_count = -(-ray_count // PACKET_RAYS)
        else:
            packet_count = -(-width // side) * -(-ray_count // (width * side))
        return cls(np.uint64(width), np.uint64(ray_count), packet_count, ZERO_U64)


class GroupPlaces(NamedTuple):
    """Where the groups of a packet begin in its batch, for `first_ray`.

    Attributes
    ----------
    table : uint64
        Address of the packet's entries in `PacketOrder.table`; 0 without one.
    first, step : uint64
        The first group's first ray, and from each group to the next, without a table.
    """

    table: np.uint64
    first: np.uint64
    step: np.uint64


class PacketSource(NamedTuple):
    """The rays of a batch, to be loaded as packets.

    Attributes
    ----------
    rays : RaySource
        Rays that follow each other lie 12 bytes apart, or 0.
    order : PacketOrder
    frame : SceneFrame
    status : uint64
        Address of the batch's statuses; only invalid ones are written.
    """

    rays: RaySource
    order: PacketOrder
    frame: SceneFrame
    status: np.uint64


@device
def entry_rows(table, group):
    """The rays of a group, by the entries at an address; see `PacketOrder.table`."""
    entry = load(np.uint64, table + group * _ENTRY_BYTES)
    return entry >> _COUNT_BITS, entry & _COUNT_MASK


@device
def group_rows(order, packet, group):
    """The rays of a group: index of the first one, and their number."""
    if order.table != NULL:
        return entry_rows(order.table + packet * GROUPS * _ENTRY_BYTES, group)
    limit = _LANES
    if order.width == ZERO_U64:
        first = packet * np.uint64(PACKET_RAYS) + group * _LANES
    else:
        across = (order.width + _SIDE - ONE_U64) // _SIDE
        x = packet % across * _SIDE
        first = (packet // across * _SIDE + group) * order.width + x
        limit = min(order.width - x, _LANES)
    return first, min(order.ray_count - min(first, order.ray_count), limit)


@device
def group_places(order, packet):
    """The `GroupPlaces` of a packet."""
    table = NULL
    if order.table != NULL:
        table = order.table + packet * GROUPS * _ENTRY_BYTES
    first, _ = group_rows(order, packet, ZERO_U64)
    return GroupPlaces(table, first, _LANES if order.width == ZERO_U64 else order.width)


@device
def group_entry(first, count):
    """An entry of `PacketOrder.table`."""
    return (first << _COUNT_BITS) | count


@device
def first_ray(places, group):
    """The first ray of a group, as of `group_rows`, which divides by the width of the image."""
    if places.table != NULL:
        return entry_rows(places.table, group)[0]
    return places.first + group * places.step


@device
def world_lanes(t, t_scale):
    """Distances in world direction lengths, for a group without slow-path rays."""
    # A distance beyond float32 is still a hit: only a miss is infinite.
    return minimum(maximum(t * t_scale, f32x16(-_LARGEST)), f32x16(_LARGEST))


@device
def t_transform(lanes, lane, is_slow):
    """Factor and offset of a ray's distances in world direction lengths."""
    if is_slow:
        return lanes.slow_t_scale[lane], lanes.slow_t_offset[lane]
    return np.float64(lanes.t_scale[lane]), np.float64(0.0)


@device
def three(rows):
    """The three vectors of a field with one per axis."""
    return rows[_X], rows[_Y], rows[_Z]


@device
def in_all_lanes(x, y, z):
    """Three numbers as vectors."""
    return f32x16(x), f32x16(y), f32x16(z)


@device
def put_three(rows, x):
    """Write three vectors to such a field."""
    rows[_X], rows[_Y], rows[_Z] = x


@device
def three_of_lane(rows, lane):
    """The three numbers of a ray in such a field."""
    return rows[_X, lane], rows[_Y, lane], rows[_Z, lane]


@device
def put_three_of_lane(rows, lane, x):
    """Write the three numbers of a ray."""
    rows[_X, lane], rows[_Y, lane], rows[_Z, lane] = x


@device
def put_local(group, ray):
    """Write 16 rays, a `LocalRay` of vectors, but for the way back to world distances."""
    put_three(group.origin, ray.origin)
    put_three(group.direction, ray.direction)
    group.t_min, group.t = ray.t_min, ray.t_max


@device
def put_local_of_lane(lanes, lane, ray):
    """Write one ray, as one that took the slow path."""
    put_three_of_lane(lanes.origin, lane, ray.origin)
    put_three_of_lane(lanes.direction, lane, ray.direction)
    lanes.t_min[lane], lanes.t[lane] = ray.t_min, ray.t_max
    lanes.slow_t_scale[lane], lanes.slow_t_offset[lane] = ray.t_scale, ray.t_offset


@device
def _reported(group):
    """Reported distances of a group without slow-path rays; inf for a miss."""
    t = world_lanes(group.t, group.t_scale)
    return select(group.prim_id == NO_PRIM, f32x16(INF_F32), t)


@device
def _put(at, vector):
    # A tile's rows are far apart and each fills a cache line: reading it first would take as long
    # as tracing a simple ray.
    if at & _LINE_BITS == np.uint64(0):
        store_nontemporal(at, vector)
    else:
        store(at, vector)


@device
def _store_group(group, first, wants_any, out):
    missed = group.prim_id == NO_PRIM
    if wants_any:
        bits = mask_bits(missed) ^ _ALL_LANES
        for lane in range(_LANES):
            store(out.seen + first + lane, np.uint8((bits >> lane) & ONE_U64))
        return
    at = first * _LANE
    _put(out.t + at, _reported(group))
    _put(out.u + at, group.u)
    _put(out.v + at, group.v)
    _put(out.prim_id + at, select(missed, i32x16(_MISS), group.prim_id))


@device_call
def _store_few(lanes, first, count, wants_any, out):
    """Write a group ray by ray."""
    no_inline()
    for lane in range(count):
        prim_id = lanes.prim_id[lane]
        if wants_any:
            store(out.seen + first + lane, np.uint8(prim_id != NO_PRIM))
            continue
        t = INF_F32
        if prim_id == NO_PRIM:
            prim_id = _MISS
        else:
            t = world_t(lanes.t[lane], lanes.slow_t_scale[lane], lanes.slow_t_offset[lane])
        at = (first + lane) * _LANE
        store(out.t + at, t)
        store(out.u + at, lanes.u[lane])
        store(out.v + at, lanes.v[lane])
        store(out.prim_id + at, prim_id)


@device
def store_group(group, first, count, is_slow, wants_any, out):
    """Write the results of a group.

    Parameters
    ----------
    group : uint64
        Address.
    first, count : uint64
        Its rays: `count` from `first` on.
    is_slow : bool
        The result of `packets.load.load_group`.
    wants_any : bool
    out : ResultAddresses
    """
    if is_slow:
        _store_few(GroupLanes(group), first, count, wants_any, out)
    else:
        _store_group(Group(group), first, wants_any, out)


@device
def store_packet(packet, number, order, slow_groups, wants_any, out):
    """Write the results of a packet.

    Parameters
    ----------
    packet, number, order
        See `load_packet`.
    slow_groups : uint64
        The result of `load_packet`.
    wants_any : bool
    out : ResultAddresses
    """
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        if count != ZERO_U64:
            is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
            store_group(packet + g * GROUP_BYTES, first, count, is_slow, wants_any, out)
