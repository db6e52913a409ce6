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
from raystream.kernels.leaf_block import BLOCK
from raystream.kernels.triangle_lanes import interval_lanes
from raystream.structures.bvh.layout import MAX_DEPTH, STACK_SIZE
from raystream.structures.bvh.stream_leaf import test_block
from raystream.structures.bvh.stream_rays import (
    FILL_BYTES,
    HOT,
    HOT_FAR,
    HOT_INV,
    HOT_NEAR,
    HOT_T,
    HOT_T_MIN,
    STREAM_BYTES,
    STREAM_RAYS,
    fill,
    stream_rays,
    three,
    write_results,
)
from raystream.structures.bvh.wide import (
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


# Small memory: the nearest distances and the keys of a node's children, the numbers of the
# lanes, and results of a leaf's lanes.
_KEYS = np.uint64(32)
_NUMBERS = np.uint64(64)
_RESULTS = np.uint64(128)
_SMALL_BYTES = 128 + 96

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
        kept += np.uint64(load(np.float32, hot + np.uint64(ray) * HOT + HOT_T) >= t_in)
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
        record = hot + np.uint64(load(np.uint32, rays + j * LANE)) * HOT
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
def _trace_stream(octant, count, records, nodes, leaves, stack, lists, hits, small, wants_any):
    """Take a stream of rays through the tree."""
    hot, cold = records.hot, records.cold
    back_x = octant & _U1 != _U0
    back_y = octant & _U2 != _U0
    back_z = octant & np.uint64(4) != _U0
    near_x = BOX_FLIP if back_x else _U0
    near_y = NODE_AXIS + BOX_FLIP if back_y else NODE_AXIS
    near_z = NODE_AXIS + NODE_AXIS + BOX_FLIP if back_z else NODE_AXIS + NODE_AXIS
    nearest = small
    keys = small + _KEYS
    lanes = small + _RESULTS
    for j in range(count):
        store(lists + j * LANE, np.uint32(j))
    lane_numbers = load(i32x8, small + _NUMBERS)

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


@kernel
def trace_streams(begin, end, nodes, leaves, frame, source, rays, wants_any, out):
    """Trace sorted rays begin to end.

    Parameters
    ----------
    begin, end : int
    nodes, leaves : int
        Addresses of the tree, see `layout.BvhArrays`; it must not be empty.
    frame : SceneFrame
    source : RaySource
    rays : SortedRays
        By octant; their rows are written.
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    out : ResultAddresses
        Written, but for nearest hits.
    """
    memory = np.empty(STREAM_BYTES + _LIST_BYTES + 64, np.uint8)
    stream = stream_rays((address(memory) + np.uint64(63)) & ~np.uint64(63))
    lists = stream.hot + np.uint64(STREAM_BYTES)
    group = scratch(FILL_BYTES)
    stack = scratch(_STACK_BYTES)
    hits = scratch(_HIT_BYTES)
    small = scratch(_SMALL_BYTES)
    for k in range(np.uint64(8)):
        store(small + _NUMBERS + k * LANE, np.int32(k))

    at = np.uint64(begin)
    for octant in range(_OCTANTS):
        octant_end = load(np.uint64, rays.octant_ends + octant * _OCTANTS)
        while at < min(octant_end, np.uint64(end)):
            count = min(min(octant_end, np.uint64(end)) - at, _CAPACITY)
            fill(stream, source, rays, at, count, frame, group, out.status)
            _trace_stream(
                octant, count, stream, nodes, leaves, stack, lists, hits, small, wants_any
            )
            write_results(stream, rays, at, count, wants_any, out)
            at += count
    # The memory must outlive its addresses.
    memory[0] = np.uint8(0)
