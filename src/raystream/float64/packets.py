"""Queries of packets of 256 rays in float64: the kernels for coherent rays.

Packets descend the tree as in `structures.bvh.packet`; leaves test triangles in float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.query import UNLIMITED
from raystream.core.rays import RayStatus
from raystream.float64.group_rays import (
    ALONE,
    GROUP_BYTES,
    INVALID,
    Float64Group,
    Float64Lanes,
    exact_ray,
    finish_rays,
    load_rays,
)
from raystream.float64.packet_leaf import collecting_leaf, counting_leaf, nearest_leaf
from raystream.float64.queries import LANES_BYTES, tree_searches
from raystream.float64.ray import ray_of_line
from raystream.float64.rows import FLOAT64_ROWS
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.constants import ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.copies import Copies
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import any_lane, scratch, store
from raystream.kernels.hits import HitAddresses
from raystream.structures.bvh.leaf_kinds import CountsLanes
from raystream.structures.bvh.packet_hits import Buffers, Collector, has_room
from raystream.structures.bvh.packet_multi_hit import ROWS, row_transform, start_rows
from raystream.structures.bvh.packet_queries import COUNTS, TREES, PacketAnswer, packet_kernel
from raystream.structures.bvh.packet_rays import GROUPS, PACKET_RAYS, GroupLanes, group_rows

#: Where a packet's groups in float64 are in the state of an answer: behind that of `ROWS`.
_RAYS_AT = np.uint64(-(-ROWS.byte_count // 64) * 64)
_STATE_BYTES = int(_RAYS_AT) + int(GROUP_BYTES) * PACKET_RAYS // 16

_NONE = np.int32(0)
_UNIT = np.float64(1.0)
_UNLIMITED = np.uint64(UNLIMITED)


@device
def _load_rays(packet, number, slow_groups, source, state):
    """Load the rays of a packet in float64, after `load_packet`; returns their address."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count != ZERO_U64:
            is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
            at = state + _RAYS_AT + g * GROUP_BYTES
            load_rays(at, source, first, count, is_slow, GroupLanes(packet, g))
    return state + _RAYS_AT


# The nearest or any hits


@device
def _begin_nearest(packet, number, slow_groups, source, wanted, state):
    return nearest_leaf(wanted.wants_any, _load_rays(packet, number, slow_groups, source, state))


@device
def _store_nearest(packet, number, slow_groups, source, scene, wanted, state):
    own = scratch(STACK_BYTES), scratch(LANES_BYTES)
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count != ZERO_U64:
            at = state + _RAYS_AT + g * GROUP_BYTES
            finish_rays(at, first, count, scene, source.frame, wanted.wants_any, wanted.out, own)
    return True


# All hits, counted or collected


@device
def _finish_alone(finish, packet, number, source, scene, wanted, state):
    """Finish the rays that are traced by themselves; report those that are invalid."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        at = state + _RAYS_AT + g * GROUP_BYTES
        if count == ZERO_U64 or not any_lane(Float64Group(at).state != _NONE):
            continue
        lanes = Float64Lanes(at)
        for k in range(count):
            if lanes.state[k] & INVALID:
                store(source.status + first + k, np.uint8(RayStatus.INVALID))
            if lanes.state[k] & ALONE:
                finish(packet, g, k, source.frame, scene, wanted, state)


@device_call
def _count_alone(packet, g, k, frame, scene, wanted, state):
    no_inline()
    lanes = Float64Lanes(state + _RAYS_AT, g)
    ray = ray_of_line(exact_ray(lanes, k), _UNIT, _UNIT, np.uint8(0), frame)
    memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
    total = _count(scene, ray, _UNLIMITED, wanted.surfaces, memory)
    CountsLanes(packet, g).count[k] = np.int32(total)


@device_call
def _collect_alone(packet, g, k, frame, scene, wanted, state):
    no_inline()
    hits, lanes = Collector(state), Float64Lanes(state + _RAYS_AT, g)
    if not has_room(hits):
        return
    half, rest = _UNIT, _UNIT
    if hits.in_world != ZERO_U64:
        half, rest = lanes.half[k], lanes.rest[k]
    ray = ray_of_line(exact_ray(lanes, k), half, rest, np.uint8(0), frame)
    memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
    first, found = hits.count, Buffers(hits.buffers).found
    rows = HitAddresses(found.t, found.u, found.v, found.prim_id)
    # If all rows become full, there is no room for the packet.
    room = hits.capacity - first
    hits.count += _keep(scene, ray, room, rows, first, wanted.surfaces, memory)
    for row in range(first, hits.count):
        store(found.ray + (row << SHIFT_32), hits.first_rays[g] + np.int32(k))


@device
def _begin_counts(packet, number, slow_groups, source, wanted, state):
    return counting_leaf(wanted.surfaces, _load_rays(packet, number, slow_groups, source, state))


@device
def _store_counts(packet, number, slow_groups, source, scene, wanted, state):
    _finish_alone(_count_alone, packet, number, source, scene, wanted, state)
    return _store_found_counts(packet, number, slow_groups, source, scene, wanted, state)


@device
def _begin_rows(packet, number, slow_groups, source, wanted, state):
    rays = _load_rays(packet, number, slow_groups, source, state)
    hits = start_rows(number, slow_groups, source, wanted, state)
    return collecting_leaf(wanted.surfaces, rays, hits)


@device
def _store_rows(packet, number, slow_groups, source, scene, wanted, state):
    _finish_alone(_collect_alone, packet, number, source, scene, wanted, state)
    return _store_found_rows(packet, number, slow_groups, source, scene, wanted, state)


class _Lengths(NamedTuple):
    """See `Float64Ray`."""

    half: np.float64
    rest: np.float64


@device
def _lengths_of(packet, g, lane, slow_groups, state):
    lanes = Float64Lanes(state + _RAYS_AT, g)
    return _Lengths(lanes.half[lane], lanes.rest[lane])


_count, _keep = tree_searches.count, tree_searches.keep
_store_found_counts = COUNTS.finish
_store_found_rows = Copies("of_float64", {**FLOAT64_ROWS, row_transform: _lengths_of}).of(
    ROWS.finish
)

#: Kernels for a `Float64Packets`, as those of `packet_queries`.
trace_packets = packet_kernel(TREES, PacketAnswer(_begin_nearest, _store_nearest, _STATE_BYTES))
FLOAT64_COUNTS = PacketAnswer(_begin_counts, _store_counts, _STATE_BYTES)
FLOAT64_ALL = PacketAnswer(_begin_rows, _store_rows, _STATE_BYTES)
