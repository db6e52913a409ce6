"""Packets of 256 rays in float64: the kernel for coherent rays.

Packets descend the tree as in `structures.bvh.packet`; leaves test triangles in float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.float64.block import (
    AXIS,
    BLOCK,
    HIGH,
    PRIM_IDS,
    SECOND,
    THIRD,
    leaf_end,
    load_corner,
    load_corners,
    test_block,
    triangle_edges,
)
from raystream.float64.group_rays import (
    FLOAT64_GROUP,
    Float64Group,
    Float64Lanes,
    finish_rays,
    intersect_rays,
    keep,
    line_of,
    load_rays,
    short_far,
)
from raystream.float64.queries import LANES_BYTES
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    any_lane,
    count_trailing_zeros,
    lanes_from_bits,
    load,
    mask16,
    popcount,
    scratch,
    select,
    store,
)
from raystream.structures.bvh.leaf_kinds import no_prefetch
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.packet import TRACE_BYTES, trace_packet
from raystream.structures.bvh.packet_leaf import entering_rays
from raystream.structures.bvh.packet_load import load_packet
from raystream.structures.bvh.packet_rays import (
    GROUPS,
    PACKET_BYTES,
    PACKET_RAYS,
    Group,
    GroupLanes,
    PacketSource,
    group_rows,
)

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle.
_FEW = np.uint64(4)

_GROUP_BYTES = np.uint64(FLOAT64_GROUP.itemsize)
_GROUPS_BYTES = FLOAT64_GROUP.itemsize * PACKET_RAYS // 16

#: Vertex 0, two edges, their cross product and the largest component, for four triangles.
_EDGES_BYTES = 13 * 32
_P, _Q, _N, _H = (np.uint64(32 * k) for k in (3, 6, 9, 12))
_SPAN_BYTES = 256
_MOST_AT = np.uint64(128)

_LANES, _BLOCK_LANES = np.uint64(16), np.uint64(4)
_INF = np.float64(np.inf)
_INF32 = np.float32(np.inf)


@device
def _store_triple(at, x):
    store(at, x[0])
    store(at + AXIS, x[1])
    store(at + (AXIS + AXIS), x[2])


@device
def _write_edges(block, to):
    """Write what the tests take of a block's triangles."""
    a = load_corners(block)
    p, q, n, h = triangle_edges(a, load_corners(block + SECOND), load_corners(block + THIRD))
    _store_triple(to, a)
    _store_triple(to + _P, p)
    _store_triple(to + _Q, q)
    _store_triple(to + _N, n)
    store(to + _H, h)


@device
def _offer(packet, lanes, g, k, low, high, is_sure, place, prim_id, wants_any):
    """Offer a triangle that may be hit to a ray; returns whether its interval became shorter."""
    if not keep(lanes, k, low, high, is_sure, place, prim_id, wants_any):
        return False
    GroupLanes(packet, g).t_active[k] = short_far(lanes, k)
    return True


@device
def _test_rays(packet, at, g, bits, block, wants_any, spans):
    """Test a block against some rays of a group; returns whether one of them has a nearer hit."""
    lanes, has_hit = Float64Lanes(at), False
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        line = line_of(lanes, k)
        found, sure = test_block(block, line, line.t_min, lanes.far[k], spans)
        while found != ZERO_U64:
            lane = count_trailing_zeros(found)
            found &= found - ONE_U64
            low = load(np.float64, spans + (lane << SHIFT_64))
            high = load(np.float64, spans + HIGH + (lane << SHIFT_64))
            is_sure = (sure >> lane) & ONE_U64 != ZERO_U64
            prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
            place = block + (lane << SHIFT_64)
            if _offer(packet, lanes, g, k, low, high, is_sure, place, prim_id, wants_any):
                has_hit = True
                if wants_any:
                    break
    return has_hit


@device
def _test_group(packet, at, g, bits, block, lane, edges, wants_any, spans):
    """Test rays of a group against a triangle; returns whether one of them has a nearer hit."""
    place, own = block + (lane << SHIFT_64), edges + (lane << SHIFT_64)
    sides = (
        load_corner(own + _P),
        load_corner(own + _Q),
        load_corner(own + _N),
        load(np.float64, own + _H),
    )
    has_hit, lanes = False, Float64Lanes(at)
    prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
    taken, far, doubtful = intersect_rays(
        Float64Group(at),
        lanes_from_bits(mask16, bits),
        load_corner(own),
        sides,
        place,
        prim_id,
        wants_any,
        spans,
    )
    if any_lane(taken):
        group = Group(packet, g)
        group.t_active = select(taken, far, group.t_active)
        has_hit = True
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        low = load(np.float64, spans + (k << SHIFT_64))
        high = load(np.float64, spans + _MOST_AT + (k << SHIFT_64))
        is_sure = high < _INF
        if _offer(packet, lanes, g, k, low, high, is_sure, place, prim_id, wants_any):
            has_hit = True
    return has_hit


class _Float64Leaf(NamedTuple):
    """Leaves in float64; see `packet.trace_packet`. `groups` is the address of float64 groups."""

    visit: Any
    prefetch: Any
    groups: np.uint64
    wants_any: bool


@device
def _visit_leaf(leaf, packet, child, leaves, box, rays, groups, own):
    """Test a leaf in float64; see `packet_leaf.visit_leaf`."""
    spans, edges, has_hit = scratch(_SPAN_BYTES), scratch(_EDGES_BYTES), False
    wants_any = leaf.wants_any
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        _write_edges(block, edges)
        for g in range(groups.first, groups.last + ONE_U64):
            bits = entering_rays(packet, g, box, rays)
            if bits == ZERO_U64:
                continue
            at = leaf.groups + g * _GROUP_BYTES
            if popcount(bits) <= _FEW:
                if _test_rays(packet, at, g, bits, block, wants_any, spans):
                    has_hit = True
                continue
            for lane in range(_BLOCK_LANES):
                if load(np.int32, block + PRIM_IDS + (lane << SHIFT_32)) < np.int32(0):
                    break
                if _test_group(packet, at, g, bits, block, lane, edges, wants_any, spans):
                    has_hit = True
        block += BLOCK
    return has_hit


@device
def _load(packet, float64_groups, number, source, order, frame, slow_groups):
    """Load the rays of a packet in float64, after `load_packet`."""
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        if count == ZERO_U64:
            continue
        at, local = float64_groups + g * _GROUP_BYTES, GroupLanes(packet, g)
        is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
        load_rays(at, source, first, count, frame, is_slow, local)
        lanes = Float64Lanes(at)
        if is_slow:
            for k in range(_LANES):
                if lanes.far[k] == -_INF:
                    local.t[k] = -_INF32


@kernel
def trace_float64_packets(begin, end, tree, frame, source, order, wants_any, status, rows):
    """Trace packets begin to end; see `stream.trace_float64_groups` for the arguments."""
    packet, float64_groups = scratch(PACKET_BYTES), scratch(_GROUPS_BYTES)
    memory, own = scratch(TRACE_BYTES), (scratch(STACK_BYTES), scratch(LANES_BYTES))
    packets = PacketSource(source.rays, order, frame, address(status))
    leaf = _Float64Leaf(_visit_leaf, no_prefetch, float64_groups, wants_any)
    for number in range(np.uint64(begin), np.uint64(end)):
        slow_groups = load_packet(packet, number, packets)
        _load(packet, float64_groups, number, source, order, frame, slow_groups)
        trace_packet(packet, GROUPS, tree, frame.max_coordinate, memory, leaf)
        for g in range(GROUPS):
            first, count = group_rows(order, number, g)
            if count != ZERO_U64:
                at = float64_groups + g * _GROUP_BYTES
                finish_rays(at, first, count, tree, frame, wants_any, status, rows, own)
