"""Leaves in float64, for packets and for groups: tests, and what becomes of the hits.

As in `structures.bvh.leaf_kinds`: the nearest or any hits are kept, or all are counted or
collected. Hits in doubt are decided one by one, by exact arithmetic.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.best import certain_hits, offer_lanes, offer_one
from raystream.geometry.float64.block import (
    PossibleHits,
    block_test,
    load_corners,
    span_of,
    test_lanes,
)
from raystream.geometry.float64.exact import estimate, solve_exactly
from raystream.geometry.float64.filters import filter_of_lane, kept_span, possible_lanes
from raystream.geometry.float64.group_rays import Float64Group, Float64Lanes, exact_ray
from raystream.geometry.float64.ray import Lengths, reported
from raystream.geometry.float64.rows import collect_row, collect_rows
from raystream.geometry.float64.search import exists, within
from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import any_lane, count_trailing_zeros, i32x16, mask_bits, select, store
from raystream.structures.bvh.leaf_kinds import Counts, CountsLanes
from raystream.structures.bvh.packets.leaf import Kind
from raystream.structures.bvh.packets.rays import three

#: Bytes of `Float64Leaf.spans`: the least distances, and behind them the largest ones.
SPAN_BYTES = 256
_LANES_HIGH = np.uint64(128)


class Float64Leaf(NamedTuple):
    """Leaves of triangles in float64, for `walks.packet.trace_packet` and `groups.trace_block`.

    Attributes
    ----------
    visit, prefetch : device function
    kind : Kind
        ``keep_lanes(leaf, packet, g, hits, triangle, prim_id)`` takes those of the `PossibleHits`
        of a group with a triangle, at an address, that are sure enough. It returns bits of the
        rays whose searches are shorter now, and of those whose hits need no further decision.
        ``keep_hits(leaf, packet, g, k, line, span, triangle, prim_id)`` takes a hit of ray k, a
        `Line`, if it is one; see `search.offer`.
    rays : uint64
        Address of the rays in float64, a `FLOAT64_GROUP` for each `Group`.
    limits_at : uint64
        Where a `Group` has the ends of its rays' intervals.
    spans : uint64
        Address of `SPAN_BYTES` bytes for the intervals of hits in doubt.
    """

    visit: Any
    prefetch: Any
    kind: Kind
    rays: np.uint64
    limits_at: np.uint64
    spans: np.uint64


@device
def test_group(leaf, packet, g, allowed, triangle, edges, prim_id):
    """Test a triangle, see `block.load_edges`, against rays of a group: all, if `allowed` is None.

    Returns bits of the rays whose searches are shorter now.
    """
    group = Float64Group(leaf.rays, g)
    origin, direction = three(group.origin), three(group.direction)
    hits = test_lanes(edges, origin, direction, group.t_min, group.far, allowed)
    if not any_lane(hits.found):
        return ZERO_U64
    found, has_function = possible_lanes(leaf.kind.filter, hits.found, prim_id, g)
    hits = PossibleHits(found, hits.sure, hits.low, hits.high)
    # Step 1: what needs no exact arithmetic, 16 at a time.
    shorter, settled = ZERO_U64, ZERO_U64
    if not has_function:
        shorter, settled = leaf.kind.keep_lanes(leaf, packet, g, hits, triangle, prim_id)
    # Step 2: the others one by one. Without a function they are few: rays near edges, at equal
    # distances, or behind the hit kept so far by less than its interval.
    sure, doubtful = mask_bits(hits.sure), mask_bits(hits.found) & ~settled
    if doubtful != ZERO_U64:
        store(leaf.spans, hits.low)
        store(leaf.spans + _LANES_HIGH, hits.high)
    lanes = Float64Lanes(leaf.rays, g)
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        far, span = lanes.far[k], span_of(leaf.spans, _LANES_HIGH, k, sure)
        leaf.kind.keep_hits(leaf, packet, g, k, exact_ray(lanes, k), span, triangle, prim_id)
        if lanes.far[k] != far:
            shorter |= ONE_U64 << k
    return shorter


class LaneSearch(NamedTuple):
    """The search of ray k of a group; hits beyond `t_far` are not wanted."""

    leaf: Float64Leaf
    packet: np.uint64
    g: np.uint64
    k: np.uint64
    t_far: np.float64


@device
def search_lane(leaf, packet, g, k):
    """The search of ray k of a group so far."""
    return LaneSearch(leaf, packet, g, k, Float64Lanes(leaf.rays, g).far[k])


@device
def take_in_lane(search, line, span, triangle, prim_id):
    """Offer a triangle to a `LaneSearch`; see `block.block_test`."""
    leaf, packet, g, k, far = search
    leaf.kind.keep_hits(leaf, packet, g, k, line, span, triangle, prim_id)
    search = search_lane(leaf, packet, g, k)
    return search, leaf.kind.wants_any and search.t_far != far


_test_block = block_test(take_in_lane)


@device
def test_one(leaf, packet, g, k, block, edges):
    """Test a block's triangles, see `block.load_edges`, against a ray of a group.

    Returns whether its search is shorter now.
    """
    search, line = search_lane(leaf, packet, g, k), exact_ray(Float64Lanes(leaf.rays, g), k)
    found, _ = _test_block(search, line, edges, block, leaf.spans)
    return found.t_far != search.t_far


# All hits


@device
def _told(t, lengths, collector):
    """Distances as they are collected: in given lengths, unless that is done later."""
    return reported(t, lengths) if collector.in_world != ZERO_U64 else t


@device
def _take_lanes(leaf, packet, g, hits, triangle, prim_id):
    """Count or collect the hits of a group that are certain."""
    group, collector = Float64Group(leaf.rays, g), leaf.kind.collector
    if collector.is_counting != ZERO_U64:
        counts, taken = Counts(packet, g), certain_hits(group, hits)
        counts.count = select(taken, counts.count + np.int32(1), counts.count)
        return ZERO_U64, mask_bits(taken)
    corners = load_corners(np.float64, triangle)
    hit = estimate(*corners, three(group.origin), three(group.direction))
    # Those whose distances are known to the last digit without exact arithmetic.
    is_known = hits.found & hits.sure & hit.is_known
    taken = is_known & within(group, hit.t, hit.t)
    if any_lane(taken):
        t = _told(hit.t, group, collector)
        collect_rows(collector, taken, t, hit.u, hit.v, i32x16(prim_id), g)
    return ZERO_U64, mask_bits(is_known)


@device
def _take_hit(leaf, packet, g, k, line, span, triangle, prim_id):
    """Count or collect the hit of a ray with a triangle, if there is one."""
    collector, surfaces = leaf.kind.collector, leaf.kind.surfaces
    own = filter_of_lane(leaf.kind.filter, Float64Lanes(leaf.rays, g), g, k)
    is_kept, span = kept_span(own, line, span, triangle, prim_id, surfaces)
    if not is_kept:
        return
    if collector.is_counting != ZERO_U64:
        counts = CountsLanes(packet, g).count
        counts[k] += np.int32(exists(line, span, triangle, surfaces))
        return
    is_hit, t, u, v = solve_exactly(line, triangle, surfaces)
    if is_hit and within(line, t, t):
        lanes = Float64Lanes(leaf.rays, g)
        t = _told(t, Lengths(lanes.half[k], lanes.rest[k]), collector)
        collect_row(collector, t, u, v, prim_id, g, k)


@device
def nearest_kind(wants_any, filter_):
    """The nearest, or any, hits are kept."""
    return Kind(offer_lanes, offer_one, False, wants_any, filter_, None)


@device
def collecting_kind(surfaces, filter_, collector):
    """All hits are collected; or counted, see `leaf_kinds.Counts`."""
    return Kind(_take_lanes, _take_hit, surfaces, False, filter_, collector)
