"""Queries of packets of 256 rays in float64: the kernels for coherent rays.

Packets descend the tree as in `structures.bvh.walks.packet`; leaves test triangles in float64.
"""

from __future__ import annotations

import numpy as np

from raystream.geometry.float64.block import BLOCK, PRIM_IDS, leaf_end, load_edges
from raystream.geometry.float64.group_rays import GROUP_BYTES, Float64Lanes, load_rays
from raystream.geometry.float64.group_results import store_nearest, trace_alone
from raystream.geometry.float64.leaf import (
    SPAN_BYTES,
    Float64Leaf,
    collecting_kind,
    nearest_kind,
    test_group,
    test_one,
)
from raystream.geometry.float64.ray import Lengths
from raystream.geometry.float64.rows import rows_of_float64
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import count_trailing_zeros, f64x4, lanes_from_bits, load, mask16, popcount
from raystream.structures.bvh.leaf_kinds import no_prefetch
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.packets.filters import packet_filter
from raystream.structures.bvh.packets.hits import Collector
from raystream.structures.bvh.packets.leaf import entering_rays
from raystream.structures.bvh.packets.multi_hit import ROWS, row_transform, start_rows
from raystream.structures.bvh.packets.queries import TREES, PacketAnswer, packet_kernel
from raystream.structures.bvh.packets.rays import (
    GROUP,
    GROUPS,
    GroupLanes,
    group_places,
    group_rows,
)

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle.
_FEW = np.uint64(6)

#: Where a packet's groups in float64 are in the state of an answer: behind that of `ROWS`. Behind
#: them, the memory of tests.
_RAYS_AT = np.uint64(-(-ROWS.byte_count // 64) * 64)
_SPANS_AT = _RAYS_AT + GROUP_BYTES * GROUPS
_STATE_BYTES = int(_SPANS_AT) + SPAN_BYTES

_LIMITS_AT = np.uint64(GROUP.fields["t_active"][1])  # type: ignore[index]
_BLOCK_LANES = np.uint64(4)


# Leaves


@device
def _test_triangles(leaf, packet, g, bits, block):
    """Test a block against rays of a group, 16 at once; returns whether a search is shorter now."""
    has_hit = False
    for lane in range(_BLOCK_LANES):
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        if prim_id < np.int32(0):
            break
        triangle, allowed = block + (lane << SHIFT_64), lanes_from_bits(mask16, bits)
        edges = load_edges(np.float64, triangle)
        kept = test_group(leaf, packet, g, allowed, triangle, edges, prim_id)
        has_hit |= kept != ZERO_U64
    return has_hit


@device
def _test_rays(leaf, packet, g, bits, block, edges):
    """Test a block against rays of a group one by one; returns whether a search is shorter now."""
    has_hit = False
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        has_hit |= test_one(leaf, packet, g, k, block, edges)
    return has_hit


@device
def _visit_leaf(leaf, packet, child, leaves, box, rays, groups, own):
    """Test a leaf in float64; see `packets.leaf.visit_leaf`."""
    has_hit = False
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        edges = load_edges(f64x4, block)
        left = groups
        while left != ZERO_U64:
            g = count_trailing_zeros(left)
            left &= left - ONE_U64
            bits = entering_rays(packet, g, box, rays)
            if bits == ZERO_U64:
                continue
            if popcount(bits) <= _FEW:
                has_hit |= _test_rays(leaf, packet, g, bits, block, edges)
            else:
                has_hit |= _test_triangles(leaf, packet, g, bits, block)
        block += BLOCK
    return has_hit


# Packets


@device
def _leaf(kind, state):
    """The leaves of a packet; they are made once to load and trace it, and once for its results."""
    rays, spans = state + _RAYS_AT, state + _SPANS_AT
    return Float64Leaf(_visit_leaf, no_prefetch, kind, rays, _LIMITS_AT, spans)


@device
def _load_rays(leaf, packet, number, slow_groups, source):
    """Load the rays of a packet in float64, after `load_packet`; returns its leaves."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count != ZERO_U64:
            is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
            at = leaf.rays + g * GROUP_BYTES
            load_rays(at, source, first, count, is_slow, GroupLanes(packet, g))
    return leaf


@device
def _filter(number, source, wanted):
    return packet_filter(wanted.filter, group_places(source.order, number), ZERO_U64)


@device
def _begin_nearest(packet, number, slow_groups, source, wanted, state):
    leaf = _leaf(nearest_kind(wanted.wants_any, _filter(number, source, wanted)), state)
    return _load_rays(leaf, packet, number, slow_groups, source)


@device
def _store_nearest(packet, number, slow_groups, source, scene, wanted, state):
    leaf = _leaf(nearest_kind(wanted.wants_any, _filter(number, source, wanted)), state)
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count != ZERO_U64:
            trace_alone(leaf, packet, g, count, source.frame, scene)
            store_nearest(leaf, packet, g, first, count, scene, wanted)
    return True


@device
def _begin_rows(packet, number, slow_groups, source, wanted, state):
    hits = start_rows(number, slow_groups, source, wanted, state)
    mine = _filter(number, source, wanted)
    leaf = _leaf(collecting_kind(wanted.surfaces, mine, hits), state)
    return _load_rays(leaf, packet, number, slow_groups, source)


@device
def _store_rows(packet, number, slow_groups, source, scene, wanted, state):
    mine = _filter(number, source, wanted)
    leaf = _leaf(collecting_kind(wanted.surfaces, mine, Collector(state)), state)
    for g in range(GROUPS):
        _, count = group_rows(source.order, number, g)
        trace_alone(leaf, packet, g, count, source.frame, scene)
    return _store_found(packet, number, slow_groups, source, scene, wanted, state)


@device
def _lengths_of(packet, g, lane, slow_groups, state):
    lanes = Float64Lanes(state + _RAYS_AT, g)
    return Lengths(lanes.half[lane], lanes.rest[lane])


_store_found = rows_of_float64({row_transform: _lengths_of}).of(ROWS.finish)

#: Kernels for a `Float64Packets`, as those of `packets.queries`.
trace_packets = packet_kernel(TREES, PacketAnswer(_begin_nearest, _store_nearest, _STATE_BYTES))
FLOAT64_ALL = PacketAnswer(_begin_rows, _store_rows, _STATE_BYTES)
