"""Leaves in float64, for packets and for groups: tests, and what becomes of the hits.

As in `structures.bvh.leaf_kinds`: the nearest or any hits are kept, all hits are counted, or all
are collected. Hits in doubt are decided one by one, by exact arithmetic.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.best import (
    Float64Best,
    certain_hits,
    offer_hits,
    offer_lanes,
)
from raystream.geometry.float64.block import (
    HIGH,
    PRIM_IDS,
    SECOND,
    THIRD,
    load_corner,
    span_of,
    test_lanes,
    test_ray,
)
from raystream.geometry.float64.exact import barycentrics, estimate, solve_exactly
from raystream.geometry.float64.group_rays import GROUP_BYTES, Float64Group, Float64Lanes, exact_ray
from raystream.geometry.float64.ray import Lengths, reported
from raystream.geometry.float64.rows import collect, collect_one
from raystream.geometry.float64.search import exists, is_counted, within
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    count_trailing_zeros,
    i32x16,
    load,
    mask_bits,
    select,
)
from raystream.structures.bvh.leaf_kinds import Counts, CountsLanes
from raystream.structures.bvh.packets.leaf import Kind
from raystream.structures.bvh.packets.rays import GROUP, three

_LOCAL_BYTES = np.uint64(GROUP.itemsize)


class Float64Leaf(NamedTuple):
    """Leaves of triangles in float64, for `walks.packet.trace_packet` and `groups.trace_block`.

    Attributes
    ----------
    visit, prefetch : device function
    kind : Kind
        Its functions take the arguments of `_keep_lanes` and `_keep_hits`, and return bits of the
        rays whose searches are shorter now, or whether the ray's is.
    rays : uint64
        Address of the rays in float64, a `FLOAT64_GROUP` for each `Group`.
    limits_at : uint64
        Where a `Group` has the ends of its rays' intervals.
    spans : uint64
        Address of `SPAN_BYTES` bytes.
    """

    visit: Any
    prefetch: Any
    kind: Kind
    rays: np.uint64
    limits_at: np.uint64
    spans: np.uint64


@device
def test_group(leaf, packet, g, allowed, triangle, shape, prim_id):
    """Test a triangle, see `block.edges_of`, against rays of a group: all, if `allowed` is None.

    Returns bits of the rays whose searches are shorter now.
    """
    group, (a, edges) = Float64Group(leaf.rays, g), shape
    origin, direction = three(group.origin), three(group.direction)
    hits = test_lanes(a, edges, origin, direction, group.t_min, group.far, allowed)
    if not any_lane(hits.found):
        return ZERO_U64
    return leaf.kind.keep_lanes(leaf, packet, g, hits, triangle, prim_id)


@device
def test_one(leaf, packet, g, k, block, triangles):
    """Test a block's triangles, see `block.edges_of`, against a ray of a group.

    Returns whether its search is shorter now.
    """
    lanes, (a, edges) = Float64Lanes(leaf.rays, g), triangles
    line = exact_ray(lanes, k)
    found, sure = test_ray(a, edges, line, line.t_min, lanes.far[k], leaf.spans)
    return found != ZERO_U64 and leaf.kind.keep_hits(leaf, packet, g, k, found, sure, block)


# Kinds


@device
def _best_of(leaf, packet, g):
    limits = packet + g * _LOCAL_BYTES + leaf.limits_at
    return Float64Best(leaf.rays + g * GROUP_BYTES, limits, leaf.spans, leaf.kind.wants_any)


@device
def _keep_lanes(leaf, packet, g, hits, triangle, prim_id):
    """Keep the `PossibleHits` of a group with the triangle at an address."""
    return offer_lanes(_best_of(leaf, packet, g), hits, triangle, prim_id)


@device
def _keep_hits(leaf, packet, g, k, found, sure, block):
    """Keep those of a ray with some triangles of a block; see `block.test_ray` for the bits."""
    return offer_hits(_best_of(leaf, packet, g), k, found, sure, block)


@device
def _count_lanes(leaf, packet, g, hits, triangle, prim_id):
    group, counts = Float64Group(leaf.rays, g), Counts(packet, g)
    taken = certain_hits(group, hits)
    counts.count = select(taken, counts.count + np.int32(1), counts.count)
    # The others one by one.
    lanes, counts = Float64Lanes(leaf.rays, g), CountsLanes(packet, g).count
    doubtful = mask_bits(hits.found) & ~mask_bits(taken)
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        counts[k] += np.int32(is_counted(exact_ray(lanes, k), triangle, leaf.kind.surfaces))
    return ZERO_U64


@device
def _count_hits(leaf, packet, g, k, found, sure, block):
    line, counts = exact_ray(Float64Lanes(leaf.rays, g), k), CountsLanes(packet, g).count
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        span, triangle = span_of(leaf.spans, HIGH, lane, sure), block + (lane << SHIFT_64)
        counts[k] += np.int32(exists(line, span, triangle, leaf.kind.surfaces))
    return False


@device
def _collect_lanes(leaf, packet, g, hits, triangle, prim_id):
    group, collector = Float64Group(leaf.rays, g), leaf.kind.collector
    # Step 1: hits for sure, whose distances are known to the last digit without exact arithmetic.
    hit = estimate(
        load_corner(triangle),
        load_corner(triangle + SECOND),
        load_corner(triangle + THIRD),
        three(group.origin),
        three(group.direction),
    )
    is_known = hits.found & hits.sure & hit.is_sure & hit.is_rounded
    taken = is_known & (hit.t >= group.t_min) & (hit.t <= group.t_max)
    if any_lane(taken):
        _, weight_v, weight_w, inverse = hit.weights
        u, v = barycentrics(weight_v, weight_w, inverse)
        t = reported(hit.t, group) if collector.in_world != ZERO_U64 else hit.t
        collect(collector, taken, t, u, v, i32x16(prim_id), g)
    # Step 2: the others one by one.
    doubtful = mask_bits(hits.found) & ~mask_bits(is_known)
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        _collect_one(leaf, g, k, triangle, prim_id)
    return ZERO_U64


@device
def _collect_hits(leaf, packet, g, k, found, sure, block):
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        _collect_one(leaf, g, k, block + (lane << SHIFT_64), prim_id)
    return False


@device
def _collect_one(leaf, g, k, triangle, prim_id):
    """Collect the hit of a ray with a triangle, if there is one."""
    lanes = Float64Lanes(leaf.rays, g)
    line = exact_ray(lanes, k)
    is_hit, t, u, v = solve_exactly(line, triangle, leaf.kind.surfaces)
    if is_hit and within(line, t, t):
        if leaf.kind.collector.in_world != ZERO_U64:
            t = reported(t, Lengths(lanes.half[k], lanes.rest[k]))
        collect_one(leaf.kind.collector, t, u, v, prim_id, g, k)


@device
def nearest_kind(wanted):
    """The nearest, or any, hits are kept."""
    return Kind(_keep_lanes, _keep_hits, False, wanted.wants_any, None, None)


@device
def counting_kind(wanted):
    """All hits are counted, see `leaf_kinds.Counts`."""
    return Kind(_count_lanes, _count_hits, wanted.surfaces, False, None, None)


@device
def collecting_kind(surfaces, collector):
    """All hits are collected."""
    return Kind(_collect_lanes, _collect_hits, surfaces, False, None, collector)
