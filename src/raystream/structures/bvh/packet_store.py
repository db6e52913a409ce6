"""Writing the results of a packet."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import stay_out_of_line
from raystream.jit.simd import (
    f32x16,
    i32x16,
    lane_bits,
    load,
    select,
    store,
    store_past_cache,
)
from raystream.kernels.local_ray import world_t
from raystream.structures.bvh.packet_rays import (
    FACTOR,
    GROUP,
    GROUPS,
    LONG_FACTOR,
    LONG_OFFSET,
    NO_PRIM,
    PRIM,
    T,
    U,
    V,
    group_rows,
    world_lanes,
)

__all__ = ["store_packet"]

_MISS = np.int32(-1)
_INF = np.float32(np.inf)
_U1 = np.uint64(1)
_LANES = np.uint64(16)
_LINE_BITS = np.uint64(63)
_ALL_LANES = np.uint64(0xFFFF)
_LANE = np.uint64(4)


@device
def _reported(packet):
    """World distances of a group without rays that took the long way; inf for a miss."""
    t = world_lanes(load(f32x16, packet + T), load(f32x16, packet + FACTOR))
    return select(load(i32x16, packet + PRIM) == NO_PRIM, f32x16(_INF), t)


@device
def _put(at, vector):
    # A tile's rows are far apart and each fills a cache line: fetching it first would take as
    # long as tracing an easy ray.
    if at & _LINE_BITS == np.uint64(0):
        store_past_cache(at, vector)
    else:
        store(at, vector)


@device
def _store_group(packet, first, wants_any, out):
    prim_ids = load(i32x16, packet + PRIM)
    missed = prim_ids == NO_PRIM
    if wants_any:
        bits = lane_bits(missed) ^ _ALL_LANES
        for lane in range(_LANES):
            store(out.seen + first + lane, np.uint8((bits >> lane) & _U1))
        return
    at = first * _LANE
    _put(out.t + at, _reported(packet))
    _put(out.u + at, load(f32x16, packet + U))
    _put(out.v + at, load(f32x16, packet + V))
    _put(out.prim_id + at, select(missed, i32x16(_MISS), prim_ids))


@device_call
def _store_few(packet, long, first, count, wants_any, out):
    """Write a group lane by lane."""
    stay_out_of_line()
    for lane in range(count):
        at = lane * _LANE
        prim_id = load(np.int32, packet + PRIM + at)
        if wants_any:
            store(out.seen + first + lane, np.uint8(prim_id != NO_PRIM))
            continue
        t = _INF
        if prim_id == NO_PRIM:
            prim_id = _MISS
        else:
            factor = load(np.float64, long + at + at)
            offset = load(np.float64, long + LONG_OFFSET + at + at)
            t = world_t(load(np.float32, packet + T + at), factor, offset)
        to = (first + lane) * _LANE
        store(out.t + to, t)
        store(out.u + to, load(np.float32, packet + U + at))
        store(out.v + to, load(np.float32, packet + V + at))
        store(out.prim_id + to, prim_id)


@device
def store_packet(packet, number, order, long_groups, wants_any, out):
    """Write the results of a packet.

    Parameters
    ----------
    packet, number, order
        See `load_packet`.
    long_groups : uint64
        What it returned.
    wants_any : bool
    out : ResultAddresses
    """
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        if count == np.uint64(0):
            continue
        at = packet + g * GROUP
        if (long_groups >> g) & _U1 == np.uint64(0):
            _store_group(at, first, wants_any, out)
        else:
            _store_few(at, at + LONG_FACTOR, first, count, wants_any, out)
