"""Queries of packets of 256 rays in float64: the kernels for coherent rays.

Packets descend the tree as in `structures.bvh.walks.packet`; leaves test triangles in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.geometry.float64.best import SPAN_BYTES
from raystream.geometry.float64.block import BLOCK, PRIM_IDS, edges_of, leaf_end
from raystream.geometry.float64.group_rays import (
    GROUP_BYTES,
    Float64Lanes,
    exact_ray,
    load_rays,
)
from raystream.geometry.float64.group_results import rays_alone, store_counts, store_nearest
from raystream.geometry.float64.leaf import (
    Float64Leaf,
    collecting_kind,
    counting_kind,
    nearest_kind,
    test_group,
    test_one,
)
from raystream.geometry.float64.queries import MEMORY_BYTES, tree_searches
from raystream.geometry.float64.ray import Lengths, ray_of_line
from raystream.geometry.float64.rows import FLOAT64_ROWS
from raystream.geometry.float64.traversal import STACK_BYTES
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.copies import Copies
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    count_trailing_zeros,
    lanes_from_bits,
    load,
    mask16,
    popcount,
    scratch,
    store,
)
from raystream.jit.views import view
from raystream.kernels.hits import HitAddresses
from raystream.structures.bvh.leaf_kinds import no_prefetch
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.packets.hits import Buffers, Collector, has_room
from raystream.structures.bvh.packets.leaf import entering_rays
from raystream.structures.bvh.packets.multi_hit import ROWS, row_transform, start_rows
from raystream.structures.bvh.packets.queries import TREES, PacketAnswer, packet_kernel
from raystream.structures.bvh.packets.rays import (
    GROUP,
    GROUPS,
    PACKET_RAYS,
    GroupLanes,
    group_rows,
    put_three,
    three,
    three_of_lane,
)

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle.
_FEW = np.uint64(6)

#: What the tests take of a block's triangles, see `block.edges_of`; and with a lane index.
_EDGES = np.dtype([*((name, "f8", (3, 4)) for name in "apqn"), ("h", "f8", 4)])
_EDGES_BYTES = _EDGES.itemsize
_Edges = view(_EDGES)
_EdgesLanes = view([*((name, "f8", (3, 4, 1)) for name in "apqn"), ("h", "f8", (4, 1))])

#: Where a packet's groups in float64 are in the state of an answer: behind that of `ROWS`.
_RAYS_AT = np.uint64(-(-ROWS.byte_count // 64) * 64)
_STATE_BYTES = int(_RAYS_AT) + int(GROUP_BYTES) * PACKET_RAYS // 16

_LIMITS_AT = np.uint64(GROUP.fields["t_active"][1])  # type: ignore[index]
_BLOCK_LANES = np.uint64(4)
_UNIT = np.float64(1.0)


# Leaves


@device
def _test_triangles(leaf, packet, g, bits, block, edges):
    """Test a block against rays of a group, 16 at once; returns whether a search is shorter now."""
    has_hit = False
    for lane in range(_BLOCK_LANES):
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        if prim_id < np.int32(0):
            break
        p, q = three_of_lane(edges.p, lane), three_of_lane(edges.q, lane)
        n = three_of_lane(edges.n, lane)
        shape = three_of_lane(edges.a, lane), (p, q, n, edges.h[lane])
        triangle, allowed = block + (lane << SHIFT_64), lanes_from_bits(mask16, bits)
        kept = test_group(leaf, packet, g, allowed, triangle, shape, prim_id)
        has_hit |= kept != ZERO_U64
    return has_hit


@device
def _test_rays(leaf, packet, g, bits, block, edges):
    """Test a block against rays of a group one by one; returns whether a search is shorter now."""
    has_hit = False
    triangles = three(edges.a), (three(edges.p), three(edges.q), three(edges.n), edges.h)
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        has_hit |= test_one(leaf, packet, g, k, block, triangles)
    return has_hit


@device
def _visit_leaf(leaf, packet, child, leaves, box, rays, groups, own):
    """Test a leaf in float64; see `packets.leaf.visit_leaf`."""
    at, has_hit = scratch(_EDGES_BYTES), False
    edges, lanes = _Edges(at), _EdgesLanes(at)
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        a, (p, q, n, edges.h) = edges_of(block)
        put_three(edges.a, a)
        put_three(edges.p, p)
        put_three(edges.q, q)
        put_three(edges.n, n)
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
                has_hit |= _test_triangles(leaf, packet, g, bits, block, lanes)
        block += BLOCK
    return has_hit


# Packets


@device
def _load_rays(packet, number, slow_groups, source, state, kind):
    """Load the rays of a packet in float64, after `load_packet`; returns its leaves."""
    rays = state + _RAYS_AT
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count != ZERO_U64:
            is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
            at = rays + g * GROUP_BYTES
            load_rays(at, source, first, count, is_slow, GroupLanes(packet, g))
    return Float64Leaf(_visit_leaf, no_prefetch, kind, rays, _LIMITS_AT, scratch(SPAN_BYTES))


def _answer(kind_of: Callable[..., Any], store_group: Callable[..., Any]) -> PacketAnswer:
    """Make an answer of functions for its leaves, see `leaf`, and results, see `group_results`."""

    @device
    def begin(packet, number, slow_groups, source, wanted, state):
        return _load_rays(packet, number, slow_groups, source, state, kind_of(wanted))

    @device
    def finish(packet, number, slow_groups, source, scene, wanted, state):
        for g in range(GROUPS):
            first, count = group_rows(source.order, number, g)
            if count != ZERO_U64:
                store_group(packet, g, state + _RAYS_AT, first, count, source, scene, wanted)
        return True

    return PacketAnswer(begin, finish, _STATE_BYTES)


# All hits


@device
def _begin_rows(packet, number, slow_groups, source, wanted, state):
    hits = start_rows(number, slow_groups, source, wanted, state)
    kind = collecting_kind(wanted.surfaces, hits)
    return _load_rays(packet, number, slow_groups, source, state, kind)


@device
def _store_rows(packet, number, slow_groups, source, scene, wanted, state):
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        if count != ZERO_U64 and rays_alone(state + _RAYS_AT, g) != ZERO_U64:
            for k in range(count):
                _collect_alone(g, k, first + k, source, scene, wanted.surfaces, state)
    return _store_found(packet, number, slow_groups, source, scene, wanted, state)


@device_call
def _collect_alone(g, k, i, source, scene, surfaces, state):
    """Collect the hits of ray i, if it is traced by itself."""
    no_inline()
    hits, lanes = Collector(state), Float64Lanes(state + _RAYS_AT, g)
    if lanes.is_alone[k] == np.int32(0) or not has_room(hits):
        return
    memory, first, found = scratch(MEMORY_BYTES), hits.count, Buffers(hits.buffers).found
    half, rest = lanes.half[k], lanes.rest[k]
    if hits.in_world == ZERO_U64:  # sorted before they are reported
        half, rest = _UNIT, _UNIT
    ray = ray_of_line(exact_ray(lanes, k), half, rest, np.uint8(0), source.frame)
    rows = HitAddresses(found.t, found.u, found.v, found.prim_id)
    # If all rows become full, there is no room for the packet.
    own, room = (memory, memory + np.uint64(STACK_BYTES)), hits.capacity - first
    hits.count += _keep(scene, ray, room, rows, first, surfaces, own)
    for row in range(first, hits.count):
        store(found.ray + (row << SHIFT_32), hits.first_rays[g] + np.int32(k))


@device
def _lengths_of(packet, g, lane, slow_groups, state):
    lanes = Float64Lanes(state + _RAYS_AT, g)
    return Lengths(lanes.half[lane], lanes.rest[lane])


_keep = tree_searches.keep
_store_found = Copies("of_float64", {**FLOAT64_ROWS, row_transform: _lengths_of}).of(ROWS.finish)

#: Kernels for a `Float64Packets`, as those of `packets.queries`.
trace_packets = packet_kernel(TREES, _answer(nearest_kind, store_nearest))
FLOAT64_COUNTS = _answer(counting_kind, store_counts)
FLOAT64_ALL = PacketAnswer(_begin_rows, _store_rows, _STATE_BYTES)
