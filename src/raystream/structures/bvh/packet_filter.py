"""The filter of a packet's hits: called for each lane that has one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    count_trailing_zeros,
    i32x16,
    lane_numbers,
    mask_bits,
    scratch,
)
from raystream.jit.views import address_of, view
from raystream.kernels.hit_filter import HitFilter, is_kept
from raystream.structures.bvh.packet_rays import GroupLanes, PacketOrder, group_rows

__all__ = ["PacketFilter", "kept_lanes", "packet_filter"]

#: Hits of a group with a triangle; and the same with a lane index.
_HITS = np.dtype([("t", "f4", 16), ("u", "f4", 16), ("v", "f4", 16)])
_Hits = view(_HITS)
_HitLanes = view([("t", "f4", (16, 1)), ("u", "f4", (16, 1)), ("v", "f4", (16, 1))])
_HITS_BYTES = _HITS.itemsize

_U0, _U1 = np.uint64(0), np.uint64(1)


class PacketFilter(NamedTuple):
    """The filter of a packet's rays.

    Attributes
    ----------
    filter : HitFilter
    order : PacketOrder
    number : uint64
        Of the packet.
    slow_groups : uint64
        See `packet_load.load_packet`.
    """

    filter: HitFilter
    order: PacketOrder
    number: np.uint64
    slow_groups: np.uint64


@device
def packet_filter(filter_, order, number, slow_groups):
    """The `PacketFilter` of a packet; None without a filter."""
    if filter_ is None:
        return None
    return PacketFilter(filter_, order, number, slow_groups)


@device_call
def _kept_bits(filter_, bits, found, prim_id, lanes, g):
    """The bits of those lanes whose hits exist."""
    no_inline()
    first, _ = group_rows(filter_.order, filter_.number, g)
    is_slow = (filter_.slow_groups >> g) & _U1 != _U0
    left = bits
    while left != _U0:
        lane = count_trailing_zeros(left)
        left &= left - _U1
        t_scale, t_offset = np.float64(lanes.t_scale[lane]), np.float64(0.0)
        if is_slow:
            t_scale, t_offset = lanes.slow_t_scale[lane], lanes.slow_t_offset[lane]
        t, u, v = found.t[lane], found.u[lane], found.v[lane]
        if not is_kept(filter_.filter, first + lane, t, t_scale, t_offset, u, v, prim_id):
            bits ^= _U1 << lane
    return bits


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
    memory = scratch(_HITS_BYTES)
    found = _Hits(memory)
    found.t, found.u, found.v = t, u, v
    lanes = GroupLanes(address_of(group))
    bits = _kept_bits(filter_, mask_bits(taken), _HitLanes(memory), prim_id, lanes, g)
    return ((i32x16(np.int32(bits)) >> lane_numbers(i32x16)) & i32x16(np.int32(1))) != i32x16(
        np.int32(0)
    )
