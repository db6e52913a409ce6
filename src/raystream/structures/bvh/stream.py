"""Streams of rays of one octant: the kernel for rays that go different ways.

A stream of some hundred rays goes down the tree together, as a list of ray numbers. At a node
the eight boxes are loaded once; each ray of the list is tested against them at once, and goes
on the lists of the children that it enters, which are visited from the nearest to the
farthest. No ray has a stack or an order of its own: against one ray at a time, the sorting,
the stack and the branches that cannot be foreseen are gone, and a node that is far away in
memory is waited for once. At a leaf each ray of the list is tested against four triangles at
once.

References
----------
Tsakok, "Faster Incoherent Rays: Multi-BVH Ray Stream Tracing", High Performance Graphics
2009; Fuetterling et al., "Efficient Ray Tracing Kernels for Modern CPU Architectures", Journal
of Computer Graphics Techniques 4(4), 2015.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    compress,
    count_bits,
    f32x8,
    float_as_bits,
    i32x8,
    i32x16,
    lane_bits,
    load,
    maximum,
    minimum,
    prefetch,
    scratch,
    select,
    store,
)
from raystream.kernels.triangle_lanes import (
    interval_lanes,
)
from raystream.structures.bvh.layout import MAX_DEPTH, STACK_SIZE
from raystream.structures.bvh.packet_load import load_group
from raystream.structures.bvh.packet_rays import (
    CLASS,
    GROUP_BYTES,
    NO_CLASS,
)
from raystream.structures.bvh.stream_leaf import test_block
from raystream.structures.bvh.stream_order import (
    BLOCK_BYTES,
    KEY_COUNT,
    gather_rays,
    sort_rays,
)
from raystream.structures.bvh.stream_rays import (
    HOT_FAR,
    HOT_INV,
    HOT_NEAR,
    HOT_T,
    HOT_T_MIN,
    RECORD,
    STREAM_RAYS,
    add_ray,
    three,
    write_miss,
    write_ray,
)
from raystream.structures.bvh.wide import (
    BLOCK,
    BOX_FLIP,
    CHILDREN,
    KEY_LANES,
    LANE,
    NODE,
    NODE_AXIS,
    leaf_address,
    leaf_end,
    sort_keys,
)

__all__ = ["trace_streams"]

_U0 = np.uint64(0)
_U1 = np.uint64(1)
_U2 = np.uint64(2)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_KEY_BITS = np.int32(~7)
_LEAST_KEY = np.int32(-(2**31))
_LINE = np.uint64(64)
_LANES = np.uint64(16)

_CAPACITY = np.uint64(STREAM_RAYS)
_OCTANTS = np.uint64(8)
_KEYS_OF_OCTANT = np.uint64(KEY_COUNT // 8)
_RECORD_BYTES = 2 * STREAM_RAYS * 64
_HIT_BYTES = 4 * STREAM_RAYS + 64

# A stack entry: the child, the length and the address of its list of rays, the distance at
# which the first of them enters it, and how many hits there were when it was made.
_ENTRY = np.uint64(24)
_COUNT = np.uint64(4)
_LIST = np.uint64(8)
_T_IN = np.uint64(16)
_HITS = np.uint64(20)
_STACK_BYTES = 24 * (STACK_SIZE + 8)

#: Bytes of all lists: on each level of the tree a list and those of its eight children, each
#: with room for the 16 lanes that are always stored.
_LIST_BYTES = 4 * (MAX_DEPTH + 1) * 9 * (STREAM_RAYS + 16)


@device
def _still_wanted(rays, count, hot, t_in):
    """Drop the rays of a list that have a hit before `t_in`; returns how many are left."""
    kept = _U0
    for j in range(count):
        ray = load(np.uint32, rays + j * LANE)
        store(rays + kept * LANE, ray)
        kept += np.uint64(load(np.float32, hot + np.uint64(ray) * RECORD + HOT_T) >= t_in)
    return kept


@device
def _visit_node(node, rays, count, hot, near_x, near_y, near_z, hits, nearest):
    """Test the rays of a list against a node's eight boxes.

    Writes the children that each ray enters as bits to `hits`, and the least distance at
    which a child is entered to `nearest`; returns the bits of the children entered at all.
    """
    low_x, high_x = load(f32x8, node + near_x), load(f32x8, node + (near_x ^ BOX_FLIP))
    low_y, high_y = load(f32x8, node + near_y), load(f32x8, node + (near_y ^ BOX_FLIP))
    low_z, high_z = load(f32x8, node + near_z), load(f32x8, node + (near_z ^ BOX_FLIP))
    least = f32x8(_INF)
    entered_by_any = _U0
    for j in range(count):
        record = hot + np.uint64(load(np.uint32, rays + j * LANE)) * RECORD
        t_in, t_out = interval_lanes(
            low_x,
            low_y,
            low_z,
            high_x,
            high_y,
            high_z,
            three(record + HOT_INV),
            three(record + HOT_NEAR),
            three(record + HOT_FAR),
        )
        entered = maximum(t_in, load(np.float32, record + HOT_T_MIN)) <= minimum(
            t_out, load(np.float32, record + HOT_T)
        )
        least = select(entered, minimum(t_in, least), least)
        bits = lane_bits(entered)
        entered_by_any |= bits
        store(hits + j * LANE, np.uint32(bits))
    # `_make_list` reads 16 at a time: what lies behind the list must enter nothing.
    store(hits + count * LANE, i32x16(np.int32(0)))
    store(nearest, least)
    return entered_by_any


@device
def _make_list(to, rays, hits, count, lane):
    """Write the rays of a list that enter a child; returns how many there are."""
    bit = i32x16(np.int32(_U1 << lane))
    zero = i32x16(np.int32(0))
    written = _U0
    for j in range(_U0, count, _LANES):
        at = j * LANE
        enters = (load(i32x16, hits + at) & bit) != zero
        store(to + written * LANE, compress(enters, load(i32x16, rays + at)))
        written += count_bits(lane_bits(enters))
    return written


@device
def _prefetch_child(child, nodes, leaves):
    at = leaf_address(leaves, child) if child < np.int32(0) else nodes + np.uint64(child) * NODE
    prefetch(at)
    prefetch(at + _LINE)
    prefetch(at + (_LINE + _LINE))
    prefetch(at + (_LINE + _LINE + _LINE))


@device
def _trace_stream(octant, count, hot, cold, nodes, leaves, stack, lists, hits, small, wants_any):
    """Take a stream of rays through the tree."""
    back_x = octant & _U1 != _U0
    back_y = octant & _U2 != _U0
    back_z = octant & np.uint64(4) != _U0
    near_x = BOX_FLIP if back_x else _U0
    near_y = NODE_AXIS + BOX_FLIP if back_y else NODE_AXIS
    near_z = NODE_AXIS + NODE_AXIS + BOX_FLIP if back_z else NODE_AXIS + NODE_AXIS
    nearest = small
    keys = small + np.uint64(32)
    lanes = small + np.uint64(64)
    for j in range(count):
        store(lists + j * LANE, np.uint32(j))
    lane_numbers = load(i32x8, small + np.uint64(128))

    top = stack
    store(top, np.int32(0))
    store(top + _COUNT, np.uint32(count))
    store(top + _LIST, lists)
    store(top + _T_IN, -_INF)
    hit_count = _U0
    store(top + _HITS, np.uint32(hit_count))
    top += _ENTRY
    while top != stack:
        top -= _ENTRY
        child = load(np.int32, top)
        rays = load(np.uint64, top + _LIST)
        length = np.uint64(load(np.uint32, top + _COUNT))
        if load(np.uint32, top + _HITS) != np.uint32(hit_count):
            length = _still_wanted(rays, length, hot, load(np.float32, top + _T_IN))
            if length == _U0:
                continue
        if child < np.int32(0):
            first = leaf_address(leaves, child)
            end = leaf_end(first, child)
            while first != end:
                hit_count += test_block(
                    rays, length, hot, cold, first, back_x, back_y, back_z, hits, lanes, wants_any
                )
                first += BLOCK
            continue
        node = nodes + np.uint64(child) * NODE
        entered = _visit_node(node, rays, length, hot, near_x, near_y, near_z, hits, nearest)
        if entered == _U0:
            continue
        # Lists of the children, the farthest first: the nearest ends up on the stack's top.
        t_in = load(f32x8, nearest)
        key = (float_as_bits(maximum(t_in, _ZERO)) & _KEY_BITS) | lane_numbers
        store(keys, sort_keys(select(t_in < _INF, key, i32x8(_LEAST_KEY))))
        room = rays + length * LANE
        for k in range(count_bits(lane_bits(t_in < _INF))):
            lane = np.uint64(load(np.int32, keys + k * LANE) & KEY_LANES)
            grandchild = load(np.int32, node + CHILDREN + lane * LANE)
            _prefetch_child(grandchild, nodes, leaves)
            written = _make_list(room, rays, hits, length, lane)
            store(top, grandchild)
            store(top + _COUNT, np.uint32(written))
            store(top + _LIST, room)
            store(top + _T_IN, load(np.float32, nearest + lane * LANE))
            store(top + _HITS, np.uint32(hit_count))
            top += _ENTRY
            room += written * LANE


@device
def _empty(octant, count, memory, nodes, leaves, wants_any, out):
    """Trace a stream, and write its results."""
    hot, cold, stack, lists, hits, small = memory
    _trace_stream(octant, count, hot, cold, nodes, leaves, stack, lists, hits, small, wants_any)
    for j in range(count):
        write_ray(hot + j * RECORD, cold + j * RECORD, wants_any, out)


@kernel
def trace_streams(begin, end, nodes, leaves, frame, source, order, wants_any, out):
    """Trace the rays of packets begin to end.

    Parameters
    ----------
    begin, end : int
        Packets as `packet_rays.group_rows` numbers them, 256 rays each.
    nodes, leaves : int
        Addresses of the tree, see `layout.BvhArrays`; it must not be empty.
    frame : SceneFrame
    source : RaySource
    order : PacketOrder
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    out : ResultAddresses
    """
    records = np.empty(_RECORD_BYTES + 64, np.uint8)
    hot = (address(records) + np.uint64(63)) & ~np.uint64(63)
    cold = hot + _CAPACITY * RECORD
    list_memory = np.empty(_LIST_BYTES, np.uint8)
    ray_count = (np.uint64(end) - np.uint64(begin)) * np.uint64(256)
    numbers = np.empty(np.int64(ray_count) * 3 + 64, np.uint32)
    keys = address(numbers)
    arrived = keys + (ray_count + _LANES) * LANE
    rays = arrived + (ray_count + _LANES) * LANE
    key_ends = np.empty(KEY_COUNT, np.uint32)
    group = scratch(GROUP_BYTES)
    block = scratch(BLOCK_BYTES)
    ends = address(key_ends)
    flags = scratch(64)
    small = scratch(160)
    for k in range(np.uint64(8)):
        store(small + np.uint64(128) + k * LANE, np.int32(k))
    memory = (hot, cold, scratch(_STACK_BYTES), address(list_memory), scratch(_HIT_BYTES), small)

    sort_rays(
        np.uint64(begin), np.uint64(end), order, source, frame, keys, arrived, rays, ends, block
    )
    at = _U0
    for octant in range(_OCTANTS):
        octant_end = np.uint64(key_ends[(octant + _U1) * _KEYS_OF_OCTANT - _U1])
        filled = _U0
        while at != octant_end:
            count = min(octant_end - at, _LANES)
            sixteen = gather_rays(block, source, rays + at * LANE, count)
            store(flags, _U0)
            store(flags + np.uint64(8), _U0)
            is_long = load_group(group, _U0, _LANES, sixteen, frame, flags)
            for lane in range(count):
                ray = np.uint64(load(np.uint32, rays + (at + lane) * LANE))
                kind = load(np.int32, group + CLASS + lane * LANE)
                if kind == NO_CLASS:
                    write_miss(ray, wants_any, out)
                    if load(np.uint8, flags + lane) != np.uint8(0):
                        store(out.status + ray, load(np.uint8, flags + lane))
                    continue
                record = filled * RECORD
                add_ray(hot + record, cold + record, group, lane, kind, is_long, ray)
                filled += _U1
            at += count
            # Room for another 16.
            if filled + _LANES > _CAPACITY:
                _empty(octant, filled, memory, nodes, leaves, wants_any, out)
                filled = _U0
        _empty(octant, filled, memory, nodes, leaves, wants_any, out)
    # The memory must outlive its addresses.
    records[0] = list_memory[0]
    numbers[0] = key_ends[0]
