"""Packets of 256 rays in float64: the kernel for coherent rays.

Packets descend the tree as in `structures.bvh.packet`; leaves test triangles in float64.
"""

from __future__ import annotations

import numpy as np

from raystream.float64.block import (
    AXIS,
    BLOCK,
    HIGH,
    PRIM_IDS,
    SECOND,
    THIRD,
    leaf_end,
    test_block,
    triangle_edges,
)
from raystream.float64.sixteen import (
    SIXTEEN,
    Sixteen,
    SixteenLanes,
    finish_sixteen,
    keep,
    line_of,
    load_sixteen,
    short_far,
    test_sixteen,
)
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    any_lane,
    count_trailing_zeros,
    f64x4,
    lanes_from_bits,
    load,
    mask16,
    popcount,
    scratch,
    select,
    store,
)
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.packet import TRACE_BYTES, packet_trace
from raystream.structures.bvh.packet_leaf import ANY, FIRST, entering_rays
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

__all__ = ["trace_exact_packets"]

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle.
_FEW = np.uint64(4)

_SIXTEEN_BYTES = np.uint64(SIXTEEN.itemsize)
_SIXTEENS_BYTES = SIXTEEN.itemsize * PACKET_RAYS // 16

#: Vertex 0, two edges, their cross product and the largest component, for four triangles.
_EDGES_BYTES = 13 * 32
_P, _Q, _N, _H = (np.uint64(32 * k) for k in (3, 6, 9, 12))
_SPAN_BYTES = 256
_MOST_AT = np.uint64(128)

_NONE, _ONE = np.uint64(0), np.uint64(1)
_WORD, _DOUBLE = np.uint64(2), np.uint64(3)
_LANES, _BLOCK_LANES = np.uint64(16), np.uint64(4)
_INF = np.float64(np.inf)
_INF32 = np.float32(np.inf)


@device
def _vertices(at):
    return load(f64x4, at), load(f64x4, at + AXIS), load(f64x4, at + (AXIS + AXIS))


@device
def _triple(at):
    return load(np.float64, at), load(np.float64, at + AXIS), load(np.float64, at + (AXIS + AXIS))


@device
def _store_triple(at, x):
    store(at, x[0])
    store(at + AXIS, x[1])
    store(at + (AXIS + AXIS), x[2])


@device
def _write_edges(block, to):
    """Write what the tests take of a block's triangles."""
    a = _vertices(block)
    p, q, n, h = triangle_edges(a, _vertices(block + SECOND), _vertices(block + THIRD))
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
    lanes, has_hit = SixteenLanes(at), False
    while bits != _NONE:
        k = count_trailing_zeros(bits)
        bits &= bits - _ONE
        line = line_of(lanes, k)
        found, sure = test_block(block, line, line.t_min, lanes.far[k], spans)
        while found != _NONE:
            lane = count_trailing_zeros(found)
            found &= found - _ONE
            low = load(np.float64, spans + (lane << _DOUBLE))
            high = load(np.float64, spans + HIGH + (lane << _DOUBLE))
            is_sure = (sure >> lane) & _ONE != _NONE
            prim_id = load(np.int32, block + PRIM_IDS + (lane << _WORD))
            place = block + (lane << _DOUBLE)
            if _offer(packet, lanes, g, k, low, high, is_sure, place, prim_id, wants_any):
                has_hit = True
                if wants_any:
                    break
    return has_hit


@device
def _test_group(packet, at, g, bits, block, lane, edges, wants_any, spans):
    """Test rays of a group against a triangle; returns whether one of them has a nearer hit."""
    place, own = block + (lane << _DOUBLE), edges + (lane << _DOUBLE)
    sides = _triple(own + _P), _triple(own + _Q), _triple(own + _N), load(np.float64, own + _H)
    has_hit, lanes = False, SixteenLanes(at)
    prim_id = load(np.int32, block + PRIM_IDS + (lane << _WORD))
    taken, far, doubtful = test_sixteen(
        Sixteen(at),
        lanes_from_bits(mask16, bits),
        _triple(own),
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
    while doubtful != _NONE:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - _ONE
        low = load(np.float64, spans + (k << _DOUBLE))
        high = load(np.float64, spans + _MOST_AT + (k << _DOUBLE))
        is_sure = high < _INF
        if _offer(packet, lanes, g, k, low, high, is_sure, place, prim_id, wants_any):
            has_hit = True
    return has_hit


@device
def _search_leaf(packet, child, leaves, box, rays, groups, own, goal, sixteens, filter_):
    """Test a leaf in float64; see `packet_leaf.visit_leaf`. `sixteens` is an address."""
    spans, edges, has_hit, wants_any = (
        scratch(_SPAN_BYTES),
        scratch(_EDGES_BYTES),
        False,
        goal == ANY,
    )
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        _write_edges(block, edges)
        for g in range(groups.first, groups.last + _ONE):
            bits = entering_rays(packet, g, box, rays)
            if bits == _NONE:
                continue
            at = sixteens + g * _SIXTEEN_BYTES
            if popcount(bits) <= _FEW:
                if _test_rays(packet, at, g, bits, block, wants_any, spans):
                    has_hit = True
                continue
            for lane in range(_BLOCK_LANES):
                if load(np.int32, block + PRIM_IDS + (lane << _WORD)) < np.int32(0):
                    break
                if _test_group(packet, at, g, bits, block, lane, edges, wants_any, spans):
                    has_hit = True
        block += BLOCK
    return has_hit


_trace_packet = packet_trace(_search_leaf)


@device
def _load(packet, sixteens, number, source, order, frame, slow_groups):
    """Load the rays of a packet in float64, after `load_packet`."""
    for g in range(GROUPS):
        first, count = group_rows(order, number, g)
        if count == _NONE:
            continue
        at, local = sixteens + g * _SIXTEEN_BYTES, GroupLanes(packet, g)
        is_slow = (slow_groups >> g) & _ONE != _NONE
        load_sixteen(at, source, first, count, frame, is_slow, local)
        lanes = SixteenLanes(at)
        if is_slow:
            for k in range(_LANES):
                if lanes.far[k] == -_INF:
                    local.t[k] = -_INF32


@kernel
def trace_exact_packets(begin, end, tree, frame, source, order, wants_any, status, rows):
    """Trace packets begin to end; see `stream.trace_exact` for the arguments."""
    packet, sixteens = scratch(PACKET_BYTES), scratch(_SIXTEENS_BYTES)
    memory, own = scratch(TRACE_BYTES), (scratch(STACK_BYTES), scratch(64))
    packets = PacketSource(source.rays, order, frame, address(status))
    goal = ANY if wants_any else FIRST
    for number in range(np.uint64(begin), np.uint64(end)):
        slow_groups = load_packet(packet, number, packets)
        _load(packet, sixteens, number, source, order, frame, slow_groups)
        _trace_packet(packet, GROUPS, tree, frame.max_coordinate, memory, goal, sixteens, None)
        for g in range(GROUPS):
            first, count = group_rows(order, number, g)
            if count != _NONE:
                at = sixteens + g * _SIXTEEN_BYTES
                finish_sixteen(at, first, count, tree, frame, wants_any, status, rows, own)
