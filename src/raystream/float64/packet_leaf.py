"""Leaves in float64 for packets of rays: their tests, and what becomes of the hits.

As `structures.bvh.packet_leaf` and `leaf_kinds`: the nearest or any hits are kept, all hits are
counted, or all are collected. Hits in doubt are decided one by one, by exact arithmetic.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.float64.best import (
    SPAN_BYTES,
    Float64Best,
    certain_hits,
    offer_hits,
    offer_lanes,
    span_of,
)
from raystream.float64.block import (
    BLOCK,
    HIGH,
    PRIM_IDS,
    SECOND,
    THIRD,
    edges_of,
    leaf_end,
    load_corner,
    test_lanes,
    test_ray,
)
from raystream.float64.exact import barycentrics, estimate, resolve
from raystream.float64.group_rays import GROUP_BYTES, Float64Group, Float64Lanes, exact_ray
from raystream.float64.ray import reported
from raystream.float64.rows import collect
from raystream.float64.search import exists, is_counted, within
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    count_trailing_zeros,
    f64x16,
    i32x16,
    lanes_from_bits,
    load,
    mask16,
    mask_bits,
    popcount,
    scratch,
    select,
)
from raystream.jit.views import view
from raystream.structures.bvh.leaf_kinds import Counts, CountsLanes, no_prefetch
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.packet_leaf import entering_rays
from raystream.structures.bvh.packet_rays import GROUP, three

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle.
_FEW = np.uint64(6)

#: What the tests take of a block's triangles, see `block.triangle_edges`; and with a lane index.
_EDGES = np.dtype([*((name, "f8", (3, 4)) for name in ("a", "p", "q", "n")), ("h", "f8", (1, 4))])
_EDGES_BYTES = _EDGES.itemsize
_Edges = view(_EDGES)
_EdgesLanes = view([*((name, "f8", (3, 4, 1)) for name in "apqn"), ("h", "f8", (1, 4, 1))])

#: A group's limits: the ends of its active rays' intervals.
_LOCAL_BYTES, _LIMITS_AT = np.uint64(GROUP.itemsize), np.uint64(GROUP.fields["t_active"][1])

_BLOCK_LANES = np.uint64(4)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)


class Float64Leaf(NamedTuple):
    """Leaves of triangles in float64, and what becomes of their hits; see `packet.trace_packet`.

    Attributes
    ----------
    visit, prefetch : device function
    keep_lanes : device function
        ``keep_lanes(leaf, packet, g, hits, place, prim_id)`` takes the `PossibleHits` of a group
        with the triangle at an address; returns whether a ray's search is shorter now.
    keep_hits : device function
        ``keep_hits(leaf, packet, g, k, found, sure, block)`` takes those of a ray with some
        triangles of a block, of which `block.test_ray` returned the bits; likewise.
    surfaces : bool
        See `exact.resolve`.
    wants_any : bool
    rays, spans : uint64
        Addresses of the packet's groups in float64, and of `SPAN_BYTES` bytes.
    collector : Collector or None
        Takes all hits.
    """

    visit: Any
    prefetch: Any
    keep_lanes: Any
    keep_hits: Any
    surfaces: bool
    wants_any: bool
    rays: np.uint64
    spans: np.uint64
    collector: Any


# Tests


@device
def _put(rows, x):
    rows[_X], rows[_Y], rows[_Z] = x


@device
def _triple(rows, lane):
    return rows[_X, lane], rows[_Y, lane], rows[_Z, lane]


@device
def _write_edges(block, edges):
    a, (p, q, n, h) = edges_of(block)
    _put(edges.a, a)
    _put(edges.p, p)
    _put(edges.q, q)
    _put(edges.n, n)
    edges.h[_X] = h


@device
def _best_of(leaf, packet, g):
    limits = packet + g * _LOCAL_BYTES + _LIMITS_AT
    return Float64Best(leaf.rays + g * GROUP_BYTES, limits, leaf.spans, leaf.wants_any)


@device
def _test_rays(leaf, packet, g, bits, block, edges):
    """Test a block against some rays of a group; returns whether a ray's search is shorter now."""
    lanes, has_hit, a = Float64Lanes(leaf.rays, g), False, three(edges.a)
    edges = three(edges.p), three(edges.q), three(edges.n), edges.h[_X]
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        line = exact_ray(lanes, k)
        found, sure = test_ray(a, edges, line, line.t_min, lanes.far[k], leaf.spans)
        if found != ZERO_U64:
            has_hit |= leaf.keep_hits(leaf, packet, g, k, found, sure, block)
    return has_hit


@device
def _test_triangle(leaf, packet, g, bits, place, edges, lane, prim_id):
    """Test a triangle against rays of a group; returns whether a ray's search is shorter now."""
    group = Float64Group(leaf.rays, g)
    hits = test_lanes(
        _triple(edges.a, lane),
        (_triple(edges.p, lane), _triple(edges.q, lane), _triple(edges.n, lane), edges.h[_X, lane]),
        three(group.origin),
        three(group.direction),
        group.t_min,
        group.far,
        lanes_from_bits(mask16, bits),
    )
    return any_lane(hits.found) and leaf.keep_lanes(leaf, packet, g, hits, place, prim_id)


@device
def _visit_leaf(leaf, packet, child, leaves, box, rays, groups, own):
    """Test a leaf in float64; see `packet_leaf.visit_leaf`."""
    at, has_hit = scratch(_EDGES_BYTES), False
    edges = _EdgesLanes(at)
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    while block != end:
        _write_edges(block, _Edges(at))
        for g in range(groups.first, groups.last + ONE_U64):
            bits = entering_rays(packet, g, box, rays)
            if bits == ZERO_U64:
                continue
            if popcount(bits) <= _FEW:
                has_hit |= _test_rays(leaf, packet, g, bits, block, _Edges(at))
                continue
            for lane in range(_BLOCK_LANES):
                prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
                if prim_id < np.int32(0):
                    break
                place = block + (lane << SHIFT_64)
                has_hit |= _test_triangle(leaf, packet, g, bits, place, edges, lane, prim_id)
        block += BLOCK
    return has_hit


# Kinds


@device
def _keep_lanes(leaf, packet, g, hits, place, prim_id):
    return offer_lanes(_best_of(leaf, packet, g), hits, place, prim_id) != ZERO_U64


@device
def _keep_hits(leaf, packet, g, k, found, sure, block):
    return offer_hits(_best_of(leaf, packet, g), k, found, sure, block)


@device
def _count_lanes(leaf, packet, g, hits, place, prim_id):
    group, counts = Float64Group(leaf.rays, g), Counts(packet, g)
    taken = certain_hits(group, hits)
    counts.count = select(taken, counts.count + np.int32(1), counts.count)
    # The others one by one.
    lanes, counts = Float64Lanes(leaf.rays, g), CountsLanes(packet, g).count
    doubtful = mask_bits(hits.found) & ~mask_bits(taken)
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        counts[k] += np.int32(is_counted(exact_ray(lanes, k), place, leaf.surfaces))
    return False


@device
def _count_hits(leaf, packet, g, k, found, sure, block):
    line, counts = exact_ray(Float64Lanes(leaf.rays, g), k), CountsLanes(packet, g).count
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        low, high, is_sure = span_of(leaf.spans, HIGH, lane, sure)
        place = block + (lane << SHIFT_64)
        counts[k] += np.int32(exists(line, low, high, is_sure, place, leaf.surfaces))
    return False


@device
def _collect_lanes(leaf, packet, g, hits, place, prim_id):
    group, collector = Float64Group(leaf.rays, g), leaf.collector
    # Step 1: hits for sure, whose distances are known to the last digit without exact arithmetic.
    hit = estimate(
        load_corner(place),
        load_corner(place + SECOND),
        load_corner(place + THIRD),
        three(group.origin),
        three(group.direction),
    )
    is_known = hits.found & hits.sure & hit.is_sure & hit.is_rounded
    taken = is_known & (hit.t >= group.t_min) & (hit.t <= group.t_max)
    if any_lane(taken):
        _, weight_v, weight_w, inverse = hit.weights
        u, v = barycentrics(weight_v, weight_w, inverse)
        collect(collector, taken, _collected(collector, hit.t, group), u, v, i32x16(prim_id), g)
    # Step 2: the others one by one.
    doubtful = mask_bits(hits.found) & ~mask_bits(is_known)
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        _collect_one(leaf, g, k, place, prim_id)
    return False


@device
def _collect_hits(leaf, packet, g, k, found, sure, block):
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        _collect_one(leaf, g, k, block + (lane << SHIFT_64), prim_id)
    return False


@device
def _collect_one(leaf, g, k, place, prim_id):
    """Collect the hit of a ray with a triangle, if there is one."""
    group, line = Float64Group(leaf.rays, g), exact_ray(Float64Lanes(leaf.rays, g), k)
    is_hit, t, u, v = resolve(line, place, leaf.surfaces)
    if is_hit and within(line, t, t):
        own, number = lanes_from_bits(mask16, ONE_U64 << k), i32x16(prim_id)
        t = _collected(leaf.collector, f64x16(t), group)
        collect(leaf.collector, own, t, f64x16(u), f64x16(v), number, g)


@device
def _collected(collector, t, group):
    """Distances as they are collected: as they are reported, unless they are sorted before."""
    return reported(t, group) if collector.in_world != ZERO_U64 else t


@device
def nearest_leaf(wants_any, rays):
    """Leaves whose nearest, or any, hits are kept."""
    return _leaf(_keep_lanes, _keep_hits, False, wants_any, rays, None)


@device
def counting_leaf(surfaces, rays):
    """Leaves whose hits are counted, see `leaf_kinds.Counts`."""
    return _leaf(_count_lanes, _count_hits, surfaces, False, rays, None)


@device
def collecting_leaf(surfaces, rays, collector):
    """Leaves whose hits are all collected."""
    return _leaf(_collect_lanes, _collect_hits, surfaces, False, rays, collector)


@device
def _leaf(keep_lanes, keep_hits, surfaces, wants_any, rays, collector):
    """See `Float64Leaf` for the arguments."""
    spans = scratch(SPAN_BYTES)
    return Float64Leaf(
        _visit_leaf, no_prefetch, keep_lanes, keep_hits, surfaces, wants_any, rays, spans, collector
    )
