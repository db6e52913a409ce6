"""Streams of groups in float64: the kernel for many incoherent rays.

Lists of groups of 16 rays descend the tree as in `structures.bvh.group_stream`; leaves test
triangles in float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.float64.best import SPAN_BYTES, Float64Best, offer_hits, offer_lanes
from raystream.float64.block import (
    BLOCK,
    PRIM_IDS,
    SECOND,
    THIRD,
    edges_of,
    leaf_end,
    load_corner,
    test_lanes,
    test_ray,
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
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    load,
    scratch,
)
from raystream.structures.bvh.group_leaf import SMALL_BYTES, Small
from raystream.structures.bvh.group_queries import group_kernel
from raystream.structures.bvh.group_rays import (
    FLAGS_AT,
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LAST_LANE,
    LISTS_AT,
    MEMORY_BYTES,
    Hot,
    load_block,
)
from raystream.structures.bvh.group_stream import STREAM_STACK_BYTES, trace_block
from raystream.structures.bvh.node_layout import LANE, leaf_address
from raystream.structures.bvh.packet_rays import (
    GROUP,
    GROUPS,
    PACKET_RAYS,
    GroupLanes,
    group_rows,
    three,
)

#: Rays that descend the tree together.
BLOCK_RAYS = 4096

_GROUPS_AT = np.uint64(-(-MEMORY_BYTES // 64) * 64)

#: A group's limits: the ends of its rays' intervals.
_LOCAL_BYTES, _LIMITS_AT = np.uint64(GROUP.itemsize), np.uint64(GROUP.fields["t"][1])

#: Bytes of memory of a call, of which most are never touched.
WORKING_BYTES = int(_GROUPS_AT) + BLOCK_RAYS // 16 * int(GROUP_BYTES) + 64

_BLOCK_LANES, _ALL = np.uint64(4), np.uint64(0xFFFF)


@device
def _group_at(memory, g):
    return memory + _GROUPS_AT + g * GROUP_BYTES


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
            load_rays(_group_at(memory, g), source, ray, length, is_slow, local)
            if is_slow:  # some may have become inactive
                _copy_limits(memory, g, _ALL)
            g += ONE_U64


@device
def _copy_limits(memory, g, bits):
    """Copy the limits of some rays of a group to their records."""
    limits = GroupLanes(memory, g).t
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = limits[k]


@device
def _best_of(leaf, memory, g):
    limits = memory + g * _LOCAL_BYTES + _LIMITS_AT
    return Float64Best(_group_at(memory, g), limits, leaf.spans, leaf.wants_any)


@device
def _test_groups(leaf, block, groups, count, memory):
    """Test a block's triangles against the groups of a list; returns the number of nearer hits."""
    hit_count = ZERO_U64
    for lane in range(_BLOCK_LANES):
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        if prim_id < np.int32(0):
            break
        place = block + (lane << SHIFT_64)
        a = load_corner(place)
        edges = triangle_edges(a, load_corner(place + SECOND), load_corner(place + THIRD))
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> GROUP_SHIFT
            group = Float64Group(_group_at(memory, g))
            origin, direction = three(group.origin), three(group.direction)
            hits = test_lanes(a, edges, origin, direction, group.t_min, group.far, None)
            bits = offer_lanes(_best_of(leaf, memory, g), hits, place, prim_id)
            hit_count += np.uint64(bits != ZERO_U64)
            _copy_limits(memory, g, bits)
    return hit_count


@device
def _test_rays(leaf, block, rays, count, memory):
    """Test a block's triangles against the rays of a list; returns the number of nearer hits."""
    hit_count, (a, edges) = ZERO_U64, edges_of(block)
    for j in range(count):
        number = np.uint64(load(np.uint32, rays + j * LANE))
        g, k = number >> LANE_SHIFT, number & LAST_LANE
        lanes = Float64Lanes(_group_at(memory, g))
        line = exact_ray(lanes, k)
        found, sure = test_ray(a, edges, line, line.t_min, lanes.far[k], leaf.spans)
        if found != ZERO_U64 and offer_hits(_best_of(leaf, memory, g), k, found, sure, block):
            hit_count += ONE_U64
            _copy_limits(memory, g, ONE_U64 << k)
    return hit_count


@device
def _visit_leaf(leaf, tree, child, rays, memory, small):
    """Test a leaf in float64; see `group_leaf.visit_leaf`."""
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


class Float64GroupLeaf(NamedTuple):
    """Leaves of triangles in float64; see `group_stream.trace_block`.

    Attributes
    ----------
    visit : device function
    spans, wants_any
        See `best.Float64Best`.
    """

    visit: Any
    spans: np.uint64
    wants_any: bool


# The kernel


@device
def _load(memory, source, first, last, scene, wanted):
    count, ray_count, group_count = load_block(memory, source, first, last, False)
    _load_rays(memory, source, first, last)
    return count, ray_count, group_count


@device
def _trace(memory, count, ray_count, scene, source, wanted):
    stack, small, groups = scratch(STREAM_STACK_BYTES), scratch(SMALL_BYTES), memory + LISTS_AT
    leaf = Float64GroupLeaf(_visit_leaf, scratch(SPAN_BYTES), wanted.wants_any)
    trace_block(memory, groups, count, ray_count, scene, stack, Small(small), leaf)


@device
def _finish(memory, source, first, last, scene, group_count, wanted):
    own, g = (scratch(STACK_BYTES), scratch(LANES_BYTES)), ZERO_U64
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(source.order, packet, row)
            if length != ZERO_U64:
                at, any_ = _group_at(memory, g), wanted.wants_any
                finish_rays(at, ray, length, scene, source.frame, any_, wanted.out, own)
                g += ONE_U64


#: The nearest or any hits of a `Float64Packets`, for a `packet_queries.NearestWanted`; in
#: `WORKING_BYTES` bytes.
trace_groups = group_kernel(_load, _trace, _finish, BLOCK_RAYS // PACKET_RAYS)
