"""Streams of groups in float64: the kernel for many incoherent rays.

Lists of groups of 16 rays descend the tree as in `structures.bvh.walks.groups`; leaves test
triangles in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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
from raystream.geometry.float64.rows import rows_of_float64, tell_float64_row
from raystream.jit.constants import BYTES_64, NULL, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import f64x4, load, scratch, store
from raystream.structures.bvh.leaf_kinds import CountsLanes, no_prefetch
from raystream.structures.bvh.node_layout import LANE, leaf_address
from raystream.structures.bvh.packets.filters import packet_filter
from raystream.structures.bvh.packets.hits import (
    COLLECTOR_BYTES,
    Buffers,
    Collector,
    has_room,
    sort_by_ray,
)
from raystream.structures.bvh.packets.rays import (
    GROUP,
    GROUPS,
    PACKET_RAYS,
    GroupLanes,
    GroupPlaces,
    group_rows,
)
from raystream.structures.bvh.ray_groups.leaf import SMALL_BYTES, Small
from raystream.structures.bvh.ray_groups.queries import group_kernel
from raystream.structures.bvh.ray_groups.rays import (
    FLAGS_AT,
    GROUP_SHIFT,
    LANE_SHIFT,
    LAST_LANE,
    LISTS_AT,
    MEMORY_BYTES,
    PLACES_AT,
    copy_limits,
    load_block,
)
from raystream.structures.bvh.walks.groups import STREAM_STACK_BYTES, trace_block

#: Rays that descend the tree together.
BLOCK_RAYS = 4096
BLOCK_PACKETS = BLOCK_RAYS // PACKET_RAYS

_RAY_GROUPS = np.uint64(BLOCK_RAYS // 16)
_GROUPS_AT = np.uint64(-(-MEMORY_BYTES // 64) * 64)

#: Where a block's hits are collected, and the ends of its rays' rows: behind the rays.
_COLLECTOR_AT = _GROUPS_AT + _RAY_GROUPS * GROUP_BYTES
_ENDS_AT = _COLLECTOR_AT + np.uint64(-(-COLLECTOR_BYTES // 64) * 64)

#: A group's limits: the ends of its rays' intervals.
_LIMITS_AT = np.uint64(GROUP.fields["t"][1])  # type: ignore[index]

#: Bytes of memory of a call, of which most are never touched.
WORKING_BYTES = int(_ENDS_AT) + 8 * BLOCK_RAYS + 64

_BLOCK_LANES, _ALL = np.uint64(4), np.uint64(0xFFFF)


@device
def _load_rays(memory, source, first, last):
    """Load the rays of packets in float64, after `load_block`."""
    g = ZERO_U64
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(source.order, packet, row)
            if length == ZERO_U64:
                continue
            local = GroupLanes(memory, g)
            is_slow = load(np.uint8, memory + FLAGS_AT + g) != np.uint8(0)
            at = memory + _GROUPS_AT + g * GROUP_BYTES
            load_rays(at, source, ray, length, is_slow, local)
            if is_slow:  # some may have become inactive
                copy_limits(memory, g, _ALL)
            g += ONE_U64


@device
def _test_groups(leaf, block, groups, count, memory):
    """Test a block against the groups of a list; returns how many have a shorter search now."""
    hit_count = ZERO_U64
    for lane in range(_BLOCK_LANES):
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        if prim_id < np.int32(0):
            break
        triangle = block + (lane << SHIFT_64)
        edges = load_edges(np.float64, triangle)
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> GROUP_SHIFT
            bits = test_group(leaf, memory, g, None, triangle, edges, prim_id)
            hit_count += np.uint64(bits != ZERO_U64)
            copy_limits(memory, g, bits)
    return hit_count


@device
def _test_rays(leaf, block, rays, count, memory):
    """Test a block against the rays of a list; likewise."""
    hit_count, edges = ZERO_U64, load_edges(f64x4, block)
    for j in range(count):
        number = np.uint64(load(np.uint32, rays + j * LANE))
        g, k = number >> LANE_SHIFT, number & LAST_LANE
        if test_one(leaf, memory, g, k, block, edges):
            hit_count += ONE_U64
            copy_limits(memory, g, ONE_U64 << k)
    return hit_count


@device
def _visit_leaf(leaf, tree, child, rays, memory, small):
    """Test a leaf in float64; see `ray_groups.leaf.visit_leaf`."""
    hit_count = ZERO_U64
    block = leaf_address(tree.leaves, child)
    end = leaf_end(block, child)
    while block != end:
        if rays.is_grouped:
            hit_count += _test_groups(leaf, block, rays.at, rays.length, memory)
        else:
            hit_count += _test_rays(leaf, block, rays.at, rays.length, memory)
        block += BLOCK
    return hit_count


# The kernels


_sort_by_ray = rows_of_float64({}).of(sort_by_ray)


@device
def _load(memory, source, first, last, scene, wanted):
    count, ray_count, group_count = load_block(
        memory, source, first, last, wanted.filter is not None
    )
    _load_rays(memory, source, first, last)
    return count, ray_count, group_count


@device
def _leaf(kind, memory):
    spans = scratch(SPAN_BYTES)
    return Float64Leaf(_visit_leaf, no_prefetch, kind, memory + _GROUPS_AT, _LIMITS_AT, spans)


@device
def _filter(wanted, memory):
    places = GroupPlaces(memory + PLACES_AT, ZERO_U64, ZERO_U64)
    return packet_filter(wanted.filter, places, ZERO_U64)


@device
def _nearest_leaf(wanted, memory):
    return _leaf(nearest_kind(wanted.wants_any, _filter(wanted, memory)), memory)


@device
def _rows_leaf(wanted, memory):
    hits = Collector(memory + _COLLECTOR_AT)
    return _leaf(collecting_kind(wanted.surfaces, _filter(wanted, memory), hits), memory)


@device
def _nothing(memory, wanted):
    """The `begin` of nearest or any hits."""


@device
def _all_fit(memory, source, first, last, wanted):
    return True


@device
def _begin_rows(memory, wanted):
    """Begin to count or collect the hits of a block."""
    hits = Collector(memory + _COLLECTOR_AT)
    hits.is_counting = np.uint64(wanted.counts != NULL)
    if wanted.counts == NULL:
        hits.buffers, hits.capacity = wanted.buffers, Buffers(wanted.buffers).capacity
        hits.in_world, hits.count = ZERO_U64, ZERO_U64
        for g in range(_RAY_GROUPS):
            hits.first_rays[g] = np.int32(g << LANE_SHIFT)


@device
def _store_counts(leaf, memory, g, first, count, tree, wanted):
    if wanted.counts == NULL:
        return
    found = CountsLanes(memory, g).count
    for k in range(count):
        store(wanted.counts + (first + k) * BYTES_64, np.int64(found[k]))


@device
def _store_rows(memory, source, first, last, wanted):
    """Sort a block's hits by ray; write its rays and the ends of their rows."""
    if wanted.counts != NULL:
        return True
    hits, to, ends = Collector(memory + _COLLECTOR_AT), Buffers(wanted.buffers), memory + _ENDS_AT
    row, g, number = to.used, ZERO_U64, to.ray_count
    if not has_room(hits) or row + hits.count > to.capacity:
        return False
    to.used = _sort_by_ray(to, hits.count, ends, np.uint64(BLOCK_RAYS), row, True)
    for packet in range(first, last):
        for group in range(GROUPS):
            ray, length = group_rows(source.order, packet, group)
            if length == ZERO_U64:
                continue
            lanes = Float64Lanes(memory + _GROUPS_AT, g)
            for k in range(length):
                row_end = load(np.uint64, ends + (((g << LANE_SHIFT) | k) << SHIFT_64))
                lengths = Lengths(lanes.half[k], lanes.rest[k])
                while row != row_end:
                    tell_float64_row(to.rows.t, row, lengths)
                    row += ONE_U64
                store(to.ray_ids + (number << SHIFT_64), np.int64(ray + k))
                number += ONE_U64
                store(to.splits + (number << SHIFT_64), np.int64(row_end))
            g += ONE_U64
    to.ray_count = number
    return True


def _kernel(
    leaf_of: Callable[..., Any],
    store_group: Callable[..., Any],
    begin: Callable[..., Any] = _nothing,
    end: Callable[..., Any] = _all_fit,
) -> Any:
    """Make a kernel of functions for leaves, and for results of groups and of a block.

    ``leaf_of(wanted, memory)``; ``store_group(leaf, memory, g, first, count, tree, wanted)``;
    ``begin(memory, wanted)``; ``end(memory, source, first, last, wanted)``, which returns whether
    results fit.
    """

    @device
    def trace(memory, count, ray_count, scene, source, wanted):
        begin(memory, wanted)
        stack, small, groups = scratch(STREAM_STACK_BYTES), scratch(SMALL_BYTES), memory + LISTS_AT
        leaf = leaf_of(wanted, memory)
        trace_block(memory, groups, count, ray_count, scene, stack, Small(small), leaf)

    @device
    def finish(memory, source, first, last, scene, group_count, wanted):
        leaf, g = leaf_of(wanted, memory), ZERO_U64
        for packet in range(first, last):
            for row in range(GROUPS):
                ray, length = group_rows(source.order, packet, row)
                if length != ZERO_U64:
                    trace_alone(leaf, memory, g, length, source.frame, scene)
                    store_group(leaf, memory, g, ray, length, scene, wanted)
                    g += ONE_U64
        return end(memory, source, first, last, wanted)

    return group_kernel(_load, trace, finish, BLOCK_PACKETS)


#: Kernels for a `Float64Packets`, in `WORKING_BYTES` bytes: the nearest or any hits for a
#: `packets.queries.NearestWanted`; all hits, or their numbers, for a
#: `packets.multi_hit.RowsWanted`.
trace_groups = _kernel(_nearest_leaf, store_nearest)
trace_rows = _kernel(_rows_leaf, _store_counts, _begin_rows, _store_rows)
