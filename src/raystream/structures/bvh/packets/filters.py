"""The filter of a packet's hits: called for the lanes that have one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import NULL, ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    gather,
    i32x16,
    lane_numbers,
    load,
    mask_bits,
    scratch,
    select,
    store,
)
from raystream.jit.views import address_of
from raystream.kernels.best import LanesFilter
from raystream.kernels.hit_filter import (
    FILTERED_BYTES,
    U_AT,
    V_AT,
    HitFilter,
    RayFilter,
    asks_at_hits,
    kept_hits,
)
from raystream.kernels.masks import admitted_lanes, lanes_with_bit
from raystream.kernels.ray import world_t
from raystream.structures.bvh.packets.rays import (
    GroupLanes,
    GroupPlaces,
    first_ray,
    t_transform,
    world_lanes,
)

_LANE = np.uint64(4)
_SHIFT_BITS = np.uint64(63)
_ZERO, _ONE = np.int32(0), np.int32(1)


class PacketFilter(NamedTuple):
    """The filter of a packet's rays.

    Attributes
    ----------
    filter : HitFilter
    places : GroupPlaces
    slow_groups : uint64
        Bits of the groups with a ray that took the slow path, see `packets.load.load_packet`. The
        groups of a block are all as of such rays.
    """

    filter: HitFilter
    places: GroupPlaces
    slow_groups: np.uint64


@device
def packet_filter(filter_, places, slow_groups):
    """The `PacketFilter` of a packet, or of a block of groups; None without a filter."""
    if filter_ is None:
        return None
    return PacketFilter(filter_, places, slow_groups)


@device
def all_slow(filter_):
    """The same `PacketFilter`, of groups that are all as of rays that took the slow path."""
    if filter_ is None:
        return None
    return PacketFilter(filter_.filter, filter_.places, ~ZERO_U64)


@device
def _is_slow(filter_, g):
    return (filter_.slow_groups >> (g & _SHIFT_BITS)) & ONE_U64 != ZERO_U64


@device
def ray_filter(filter_, lanes, g, k):
    """The `RayFilter` of ray k of group g, whose lanes are given; None without a filter."""
    if filter_ is None:
        return None
    first = first_ray(filter_.places, g)
    t_scale, t_offset = t_transform(lanes, k, _is_slow(filter_, g))
    return RayFilter(filter_.filter, first + k, t_scale, t_offset)


@device
def lanes_filter(filter_, group, g):
    """The `LanesFilter` of group g, which is given; None without a filter."""
    if filter_ is None:
        return None
    return LanesFilter(kept_lanes, filter_, group, g)


@device
def rays_that_enter(filter_, g, bits, mask):
    """Bits of those rays of group g that may hit what has a mask, for a `PacketFilter` or None."""
    if filter_ is None:
        return bits
    own = filter_.filter
    if own.entered == NULL:
        return bits
    return bits & mask_bits(lanes_with_bit(own.entered, first_ray(filter_.places, g), mask))


@device
def _unskipped(filter_, taken, prim_id, first):
    """The mask of those lanes whose rays do not skip a triangle."""
    # Lanes that are not taken may be beyond the last ray: they read what a taken one does.
    some = i32x16(np.int32(count_trailing_zeros(mask_bits(taken))))
    rows = select(taken, lane_numbers(i32x16), some) * np.int32(filter_.skip_count)
    at = filter_.skipped + first * filter_.skip_count * _LANE
    for k in range(filter_.skip_count):
        taken = taken & (gather(np.int32, at + k * _LANE, rows) != i32x16(prim_id))
    return taken


@device
def lanes_that_may_hit(own, taken, prim_id, first):
    """The mask of those lanes that masks and skipped triangles of a `HitFilter` leave.

    `first` is the batch index of the first lane's ray.
    """
    if own.masks != NULL:
        taken = taken & admitted_lanes(own.masks, first, prim_id)
    if own.skip_count != ZERO_U64 and mask_bits(taken) != ZERO_U64:
        taken = _unskipped(own, taken, prim_id, first)
    return taken


@device
def kept_lanes(filter_, taken, t, u, v, prim_id, group, g):
    """The mask of those lanes whose hits with a triangle exist.

    Parameters
    ----------
    filter_ : PacketFilter
    taken : mask16
    t, u, v : f32x16
    prim_id : int32
    group : view of Group
    g : uint64
        The group's index.
    """
    own = filter_.filter
    if not asks_at_hits(own):
        return taken
    first = first_ray(filter_.places, g)
    taken = lanes_that_may_hit(own, taken, prim_id, first)
    bits = mask_bits(taken)
    if own.function == NULL or bits == ZERO_U64:
        return taken
    hits = scratch(FILTERED_BYTES)
    store(hits, world_lanes(t, group.t_scale))
    store(hits + U_AT, u)
    store(hits + V_AT, v)
    if _is_slow(filter_, g):
        _put_slow(hits, bits, t, group)
    bits = kept_hits(own, bits, hits, prim_id, first)
    return ((i32x16(np.int32(bits)) >> lane_numbers(i32x16)) & i32x16(_ONE)) != i32x16(_ZERO)


@device
def _put_slow(hits, bits, t, group):
    """Write the distances of a group with rays that took the slow path."""
    lanes, local = GroupLanes(address_of(group)), scratch(64)
    store(local, t)
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        at = lane << SHIFT_32
        t_scale, t_offset = lanes.slow_t_scale[lane], lanes.slow_t_offset[lane]
        store(hits + at, world_t(load(np.float32, local + at), t_scale, t_offset))
