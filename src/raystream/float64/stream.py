"""Streams of groups in float64: the kernel for many incoherent rays.

Lists of groups of 16 rays descend the tree as in `structures.bvh.group_stream`; leaves test
triangles in float64.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.float64.block import (
    BLOCK,
    HIGH,
    PRIM_IDS,
    SECOND,
    THIRD,
    leaf_end,
    load_corner,
    test_block,
    triangle_edges,
)
from raystream.float64.group_rays import (
    FLOAT64_GROUP,
    Float64Group,
    Float64Lanes,
    finish_rays,
    intersect_rays,
    keep,
    line_of,
    load_rays,
    short_far,
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
    mask_bits,
    scratch,
    select,
)
from raystream.structures.bvh.group_leaf import SMALL_BYTES, Small
from raystream.structures.bvh.group_rays import (
    FLAGS_AT,
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LISTS_AT,
    MEMORY_BYTES,
    Hot,
    load_block,
)
from raystream.structures.bvh.group_stream import STREAM_STACK_BYTES, trace_block
from raystream.structures.bvh.node_layout import LANE, leaf_address
from raystream.structures.bvh.packet_rays import (
    GROUPS,
    PACKET_RAYS,
    Group,
    GroupLanes,
    group_rows,
)

#: Rays that descend the tree together.
BLOCK_RAYS = 4096
_PACKETS = np.uint64(BLOCK_RAYS // PACKET_RAYS)

_GROUPS_AT = np.uint64(-(-MEMORY_BYTES // 64) * 64)
_GROUP_BYTES = np.uint64(FLOAT64_GROUP.itemsize)

#: Bytes of memory of a call, of which most are never touched.
WORKING_BYTES = int(_GROUPS_AT) + BLOCK_RAYS // 16 * FLOAT64_GROUP.itemsize + 64

_BLOCK_LANES, _LAST_LANE = np.uint64(4), np.uint64(15)
_LANES = np.uint64(16)
_ALL = np.uint64(0xFFFF)
_MOST_AT = np.uint64(128)
_SPAN_BYTES = 256
_INF = np.float64(np.inf)
_INF32 = np.float32(np.inf)


@device
def _group_at(memory, g):
    return memory + _GROUPS_AT + g * _GROUP_BYTES


@device
def _load(memory, first, last, source, order, frame):
    """Load the rays of packets in float64, after `load_block`."""
    g = ZERO_U64
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(order, packet, row)
            if length == ZERO_U64:
                continue
            local = GroupLanes(memory, g)
            is_slow = load(np.uint8, memory + FLAGS_AT + g) != np.uint8(0)
            load_rays(_group_at(memory, g), source, ray, length, frame, is_slow, local)
            if is_slow:
                lanes = Float64Lanes(_group_at(memory, g))
                for k in range(_LANES):
                    if lanes.far[k] == -_INF:
                        local.t[k] = -_INF32
                        Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = -_INF32
            g += ONE_U64


@device
def _keep(memory, g, k, low, high, is_sure, place, prim_id, wants_any):
    """Offer a triangle that may be hit to a ray; returns whether its interval became shorter."""
    lanes = Float64Lanes(_group_at(memory, g))
    if not keep(lanes, k, low, high, is_sure, place, prim_id, wants_any):
        return False
    far = short_far(lanes, k)
    GroupLanes(memory, g).t[k] = far
    Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = far
    return True


@device
def _all_rays():
    return lanes_from_bits(mask16, _ALL)


@device
def _leaf_with_groups(block, groups, count, memory, wants_any, spans):
    """Test a block's triangles against the groups of a list; returns the number of hits."""
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
            taken, far, doubtful = intersect_rays(
                group, _all_rays(), a, edges, place, prim_id, wants_any, spans
            )
            bits = mask_bits(taken)
            if bits != ZERO_U64:
                hit_count += ONE_U64
                local = Group(memory, g)
                local.t = select(taken, far, local.t)
                lanes = GroupLanes(memory, g)
                while bits != ZERO_U64:
                    k = count_trailing_zeros(bits)
                    bits &= bits - ONE_U64
                    Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = lanes.t[k]
            while doubtful != ZERO_U64:
                k = count_trailing_zeros(doubtful)
                doubtful &= doubtful - ONE_U64
                low = load(np.float64, spans + (k << SHIFT_64))
                high = load(np.float64, spans + _MOST_AT + (k << SHIFT_64))
                is_sure = high < _INF
                hit_count += np.uint64(
                    _keep(memory, g, k, low, high, is_sure, place, prim_id, wants_any)
                )
    return hit_count


@device
def _leaf_with_rays(block, rays, count, memory, wants_any, spans):
    """Test a block's triangles against the rays of a list; returns the number of hits."""
    hit_count = ZERO_U64
    for j in range(count):
        number = np.uint64(load(np.uint32, rays + j * LANE))
        g, k = number >> LANE_SHIFT, number & _LAST_LANE
        lanes = Float64Lanes(_group_at(memory, g))
        line = line_of(lanes, k)
        found, sure = test_block(block, line, line.t_min, lanes.far[k], spans)
        while found != ZERO_U64:
            lane = count_trailing_zeros(found)
            found &= found - ONE_U64
            low = load(np.float64, spans + (lane << SHIFT_64))
            high = load(np.float64, spans + HIGH + (lane << SHIFT_64))
            is_sure = (sure >> lane) & ONE_U64 != ZERO_U64
            prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
            place = block + (lane << SHIFT_64)
            is_kept = _keep(memory, g, k, low, high, is_sure, place, prim_id, wants_any)
            hit_count += np.uint64(is_kept)
            if wants_any and is_kept:
                break
    return hit_count


class _Float64Leaf(NamedTuple):
    """Leaves in float64; see `group_stream.trace_block`."""

    visit: Any
    wants_any: bool


@device
def _visit_leaf(leaf, tree, child, rays, memory, small):
    """Test a leaf in float64; see `group_stream.trace_block`."""
    spans, hit_count, wants_any = scratch(_SPAN_BYTES), ZERO_U64, leaf.wants_any
    block = leaf_address(tree.leaves, child)
    end = leaf_end(block, child)
    while block != end:
        if rays.is_grouped:
            hit_count += _leaf_with_groups(block, rays.at, rays.length, memory, wants_any, spans)
        else:
            hit_count += _leaf_with_rays(block, rays.at, rays.length, memory, wants_any, spans)
        block += BLOCK
    return hit_count


@kernel
def trace_float64_groups(begin, end, tree, source, packets, wants_any, status, rows, memory):
    """Trace packets begin to end.

    Parameters
    ----------
    begin, end : int
    tree : Float64Tree
        With nodes.
    source : Float64Source
    packets : PacketSource
        Of the same rays.
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    status : ndarray of shape (N,), uint8
    rows : HitArrays
        See `group_rays.finish_rays`.
    memory : int
        Address of `WORKING_BYTES` bytes; a multiple of 64.
    """
    memory, order, frame = np.uint64(memory), packets.order, packets.frame
    stack, own = scratch(STREAM_STACK_BYTES), (scratch(STACK_BYTES), scratch(LANES_BYTES))
    small, groups = Small(scratch(SMALL_BYTES)), memory + LISTS_AT
    for first in range(np.uint64(begin), np.uint64(end), _PACKETS):
        last = min(first + _PACKETS, np.uint64(end))
        count, ray_count, _ = load_block(memory, packets, first, last, False)
        _load(memory, first, last, source, order, frame)
        leaf = _Float64Leaf(_visit_leaf, wants_any)
        trace_block(memory, groups, count, ray_count, tree, stack, small, leaf)
        g = ZERO_U64
        for packet in range(first, last):
            for row in range(GROUPS):
                ray, length = group_rows(order, packet, row)
                if length != ZERO_U64:
                    at = _group_at(memory, g)
                    finish_rays(at, ray, length, tree, frame, wants_any, status, rows, own)
                    g += ONE_U64
