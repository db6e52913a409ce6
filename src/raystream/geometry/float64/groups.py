"""Streams of groups in float64: the kernel for many incoherent rays.

Lists of groups of 16 rays descend the tree as in `structures.bvh.walks.groups`; leaves test
triangles in float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.geometry.float64.block import BLOCK, PRIM_IDS, leaf_end, load_edges
from raystream.geometry.float64.group_rays import GROUP_BYTES, load_rays
from raystream.geometry.float64.group_results import store_nearest, trace_alone
from raystream.geometry.float64.leaf import (
    SPAN_BYTES,
    Float64Leaf,
    collecting_kind,
    nearest_kind,
    test_group,
    test_one,
)
from raystream.jit.constants import BYTES_64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import f64x4, load, scratch, store
from raystream.structures.bvh.leaf_kinds import CountsLanes, no_prefetch
from raystream.structures.bvh.node_layout import LANE, leaf_address
from raystream.structures.bvh.packets.filters import packet_filter
from raystream.structures.bvh.packets.hits import COLLECTOR_BYTES, Collector
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

_GROUPS_AT = np.uint64(-(-MEMORY_BYTES // 64) * 64)

#: A group's limits: the ends of its rays' intervals.
_LIMITS_AT = np.uint64(GROUP.fields["t"][1])  # type: ignore[index]

#: Bytes of memory of a call, of which most are never touched.
WORKING_BYTES = int(_GROUPS_AT) + BLOCK_RAYS // 16 * int(GROUP_BYTES) + 64

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
def _counting_leaf(wanted, memory):
    # Of a collector, counting needs nothing else.
    hits = Collector(scratch(COLLECTOR_BYTES))
    hits.is_counting = ONE_U64
    return _leaf(collecting_kind(wanted.surfaces, _filter(wanted, memory), hits), memory)


@device
def _store_counts(leaf, memory, g, first, count, tree, wanted):
    found = CountsLanes(memory, g).count
    for k in range(count):
        store(wanted.counts + (first + k) * BYTES_64, np.int64(found[k]))


def _kernel(leaf_of: Callable[..., Any], store_group: Callable[..., Any]) -> Any:
    """Make a kernel of functions for leaves, and for results of groups.

    ``leaf_of(wanted, memory)``; ``store_group(leaf, memory, g, first, count, tree, wanted)``
    """

    @device
    def trace(memory, count, ray_count, scene, source, wanted):
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

    return group_kernel(_load, trace, finish, BLOCK_PACKETS)


#: Kernels for a `Float64Packets`, in `WORKING_BYTES` bytes: the nearest or any hits for a
#: `packets.queries.NearestWanted`, the numbers of hits for a `packets.multi_hit.RowsWanted`.
trace_groups = _kernel(_nearest_leaf, store_nearest)
count_in_groups = _kernel(_counting_leaf, _store_counts)
