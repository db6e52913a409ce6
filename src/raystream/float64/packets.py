"""Packets of 256 rays in float64: the kernel for coherent rays.

Packets descend the tree as in `structures.bvh.packet`; leaves test triangles in float64.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.float64.best import SPAN_BYTES, Float64Best, offer_hits, offer_lanes
from raystream.float64.block import (
    AXIS,
    BLOCK,
    PRIM_IDS,
    SECOND,
    THIRD,
    leaf_end,
    load_corner,
    load_corners,
    test_block,
    test_lanes,
    triangle_edges,
)
from raystream.float64.group_rays import (
    GROUP_BYTES,
    Float64Group,
    Float64Lanes,
    exact_ray,
    finish_rays,
    load_rays,
)
from raystream.float64.queries import LANES_BYTES
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    count_trailing_zeros,
    lanes_from_bits,
    load,
    mask16,
    popcount,
    scratch,
    store,
)
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.packet import TRACE_BYTES, packet_trace
from raystream.structures.bvh.packet_leaf import ANY, FIRST, entering_rays
from raystream.structures.bvh.packet_load import load_packet
from raystream.structures.bvh.packet_rays import (
    GROUP,
    GROUPS,
    PACKET_BYTES,
    PACKET_RAYS,
    GroupLanes,
    group_rows,
    three,
)

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle.
_FEW = np.uint64(4)

_GROUPS_BYTES = int(GROUP_BYTES) * PACKET_RAYS // 16

#: Vertex 0, two edges, their cross product and the largest component, for four triangles.
_EDGES_BYTES = 13 * 32
_P, _Q, _N, _H = (np.uint64(32 * k) for k in (3, 6, 9, 12))

#: A group's limits: the ends of its active rays' intervals.
_LOCAL_BYTES, _LIMITS_AT = np.uint64(GROUP.itemsize), np.uint64(GROUP.fields["t_active"][1])

_BLOCK_LANES = np.uint64(4)


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
def _best_of(leaf, packet, g):
    limits = packet + g * _LOCAL_BYTES + _LIMITS_AT
    return Float64Best(leaf.rays + g * GROUP_BYTES, limits, leaf.spans, leaf.wants_any)


@device
def _test_rays(leaf, packet, g, bits, block):
    """Test a block against some rays of a group; returns whether one of them has a nearer hit."""
    best, has_hit = _best_of(leaf, packet, g), False
    lanes = Float64Lanes(best.rays)
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        line = exact_ray(lanes, k)
        found, sure = test_block(block, line, line.t_min, lanes.far[k], leaf.spans)
        has_hit |= offer_hits(best, k, found, sure, block)
    return has_hit


@device
def _test_triangle(leaf, packet, g, bits, place, edges, prim_id):
    """Test a triangle against rays of a group; returns whether one of them has a nearer hit."""
    best = _best_of(leaf, packet, g)
    group = Float64Group(best.rays)
    p, q, n = load_corner(edges + _P), load_corner(edges + _Q), load_corner(edges + _N)
    hits = test_lanes(
        load_corner(edges),
        (p, q, n, load(np.float64, edges + _H)),
        three(group.origin),
        three(group.direction),
        group.t_min,
        group.far,
        lanes_from_bits(mask16, bits),
    )
    return offer_lanes(best, hits, place, prim_id) != ZERO_U64


@device
def _visit_leaf(leaf, packet, child, leaves, box, rays, groups, own):
    """Test a leaf in float64; see `packet_leaf.visit_leaf`."""
    edges, has_hit = scratch(_EDGES_BYTES), False
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        _write_edges(block, edges)
        for g in range(groups.first, groups.last + ONE_U64):
            bits = entering_rays(packet, g, box, rays)
            if bits == ZERO_U64:
                continue
            if popcount(bits) <= _FEW:
                has_hit |= _test_rays(leaf, packet, g, bits, block)
                continue
            for lane in range(_BLOCK_LANES):
                prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
                if prim_id < np.int32(0):
                    break
                at = lane << SHIFT_64
                has_hit |= _test_triangle(leaf, packet, g, bits, block + at, edges + at, prim_id)
        block += BLOCK
    return has_hit


class Float64Leaf(NamedTuple):
    """Leaves in float64; see `packet.trace_packet`."""

    rays: np.uint64
    spans: np.uint64
    wants_any: bool


@device
def _search_leaf(packet, child, leaves, box, rays, groups, own, goal, leaf, filter_):
    return _visit_leaf(leaf, packet, child, leaves, box, rays, groups, own)


_trace_packet = packet_trace(_search_leaf)


@device
def _load(packet, float64_groups, number, source, slow_groups):
    """Load the rays of a packet in float64, after `load_packet`."""
    for g in range(GROUPS):
        first, count = group_rows(source.packets.order, number, g)
        if count != ZERO_U64:
            is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
            at = float64_groups + g * GROUP_BYTES
            load_rays(at, source, first, count, is_slow, GroupLanes(packet, g))


@kernel
def trace_float64_packets(begin, end, tree, source, wants_any, out):
    """Trace packets begin to end; see `stream.trace_float64_groups` for the arguments."""
    packet, float64_groups = scratch(PACKET_BYTES), scratch(_GROUPS_BYTES)
    memory, own = scratch(TRACE_BYTES), (scratch(STACK_BYTES), scratch(LANES_BYTES))
    order, frame = source.packets.order, source.packets.frame
    leaf = Float64Leaf(float64_groups, scratch(SPAN_BYTES), wants_any)
    goal = ANY if wants_any else FIRST
    for number in range(np.uint64(begin), np.uint64(end)):
        slow_groups = load_packet(packet, number, source.packets)
        _load(packet, float64_groups, number, source, slow_groups)
        _trace_packet(packet, GROUPS, tree, frame.max_coordinate, memory, goal, leaf, None)
        for g in range(GROUPS):
            first, count = group_rows(order, number, g)
            if count != ZERO_U64:
                at = float64_groups + g * GROUP_BYTES
                finish_rays(at, first, count, tree, frame, wants_any, out, own)
