"""Streams of groups: the walk for incoherent rays that start near each other.

Rays in the order of the batch are loaded as groups of 16, one vector per number. A list of groups
descends the tree, from the root, with the rays of each group that are in a box as bits: a box is
tested against 16 rays at once, in any direction. Where few rays of a group are left, the list is
expanded to a list of single rays; each of these is tested against the eight boxes of a node, and
appended to the lists of the children that it enters, which are visited from the nearest to the
farthest. Nothing is sorted, and results are written 16 at a time.

References
----------
Tsakok, "Faster Incoherent Rays: Multi-BVH Ray Stream Tracing", High Performance Graphics
2009; Benthin, Wald, Woop, Ernst and Mark, "Combining Single and Packet-Ray Tracing for Arbitrary
Ray Distributions on the Intel MIC Architecture", IEEE TVCG 18(9), 2012.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ONE_U64, THREE_U64, TWO_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    compress,
    count_trailing_zeros,
    f32x8,
    f32x16,
    float_as_bits,
    i32x8,
    i32x16,
    lane_numbers,
    lanes_from_bits,
    load,
    mask16,
    mask_bits,
    maximum,
    minimum,
    popcount,
    reduce_min,
    select,
    store,
)
from raystream.jit.views import address_of, view
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import (
    KEY_LANES,
    LANE,
    Node,
    NodeLanes,
    prefetch_child,
    sort_keys,
)
from raystream.structures.bvh.packets.rays import Group, in_all_lanes, three
from raystream.structures.bvh.ray_groups.leaf import SmallLanes
from raystream.structures.bvh.ray_groups.rays import (
    GROUP_SHIFT,
    HITS_AT,
    HOT_AT,
    LANE_SHIFT,
    RAY_BITS,
    Hot,
    interval,
)

#: Fewer rays than this per group, on average, continue as single rays.
_FEW = np.uint64(10)
_LANES, _WIDTH = np.uint64(16), np.uint64(8)
_FOUR, _FIVE = np.uint64(4), np.uint64(5)
_KEY_BITS = np.int32(~7)
_LEAST_KEY = np.int32(-(2**31))

#: A stack entry: a child, its list, the memory behind all lists that are in use, the least distance
#: at which a ray enters, the number of hits when it was pushed, and the rays in a list of groups,
#: 0 for a list of rays.
_ENTRY = np.dtype(
    [
        ("child", "i4"),
        ("count", "u4"),
        ("list", "u8"),
        ("room", "u8"),
        ("t_in", "f4"),
        ("hit_count", "u4"),
        ("ray_count", "u8"),
    ]
)
_Entry = view(_ENTRY)
STREAM_STACK_BYTES = _ENTRY.itemsize * (STACK_SIZE + 8)


@device
def _push(stack, top, node, small, lanes, room, hit_count, tree):
    """Push the children of a node that have a list, the farthest first; returns the height."""
    t_in = small.t_in
    entered = t_in < INF_F32
    key = (float_as_bits(maximum(t_in, ZERO_F32)) & _KEY_BITS) | lane_numbers(i32x8)
    small.keys = sort_keys(select(entered, key, i32x8(_LEAST_KEY)))
    children = node.children
    for k in range(popcount(mask_bits(entered))):
        lane = np.uint64(lanes.keys[k] & KEY_LANES)
        prefetch_child(children[lane], tree.nodes, tree.leaves)
        entry = _Entry(stack, top)
        entry.child, entry.list, entry.room = children[lane], lanes.list[lane], room
        entry.count, entry.ray_count = np.uint32(lanes.count[lane]), lanes.ray_count[lane]
        entry.t_in, entry.hit_count = lanes.t_in[lane], np.uint32(hit_count)
        top += ONE_U64
    return top


@device
def _visit_with_groups(node, groups, count, memory, small, lanes, room):
    """Test a node's boxes against the groups of a list; make the children's lists.

    Returns the end of the lists.
    """
    small.t_in = f32x8(INF_F32)
    planes, children = node.planes, node.children
    for lane in range(_WIDTH):
        if children[lane] == np.int32(0):
            break
        low = in_all_lanes(planes[ZERO_U64, lane], planes[TWO_U64, lane], planes[_FOUR, lane])
        high = in_all_lanes(planes[ONE_U64, lane], planes[THREE_U64, lane], planes[_FIVE, lane])
        least = f32x16(INF_F32)
        written, ray_count = ZERO_U64, ZERO_U64
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> GROUP_SHIFT
            group = Group(memory, g)
            inv, near, far = three(group.inv), three(group.near), three(group.far)
            t_in, t_out = interval((low, high), inv, near, far)
            entered = maximum(t_in, group.t_min) <= minimum(t_out, group.t)
            least = select(entered, minimum(t_in, least), least)
            bits = mask_bits(entered)
            store(room + written * LANE, np.uint32((g << GROUP_SHIFT) | bits))
            written += np.uint64(bits != ZERO_U64)
            ray_count += popcount(bits)
        lanes.list[lane], lanes.count[lane], lanes.ray_count[lane] = room, written, ray_count
        lanes.t_in[lane] = reduce_min(least)
        room += written * LANE
    return room


@device
def _visit_with_rays(node, rays, count, memory, small, lanes, hits, room):
    """The same with a list of rays."""
    planes = node.planes
    low = planes[ZERO_U64], planes[TWO_U64], planes[_FOUR]
    high = planes[ONE_U64], planes[THREE_U64], planes[_FIVE]
    is_used = node.children != np.int32(0)
    least = f32x8(INF_F32)
    for j in range(count):
        ray = Hot(memory + HOT_AT, np.uint64(load(np.uint32, rays + j * LANE)))
        t_in, t_out = interval((low, high), ray.inv, ray.low, ray.high)
        entered = is_used & (maximum(t_in, ray.t_min) <= minimum(t_out, ray.t))
        least = select(entered, minimum(t_in, least), least)
        store(hits + j * LANE, np.uint32(mask_bits(entered)))
    # Bits behind the list must be 0: 16 are read at a time.
    store(hits + count * LANE, i32x16(np.int32(0)))
    small.t_in = least
    zero = i32x16(np.int32(0))
    found = mask_bits(least < INF_F32)
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        bit = i32x16(np.int32(ONE_U64 << lane))
        written = ZERO_U64
        for j in range(ZERO_U64, count, _LANES):
            at = j * LANE
            enters = (load(i32x16, hits + at) & bit) != zero
            store(room + written * LANE, compress(enters, load(i32x16, rays + at)))
            written += popcount(mask_bits(enters))
        lanes.list[lane], lanes.count[lane], lanes.ray_count[lane] = room, written, ZERO_U64
        room += written * LANE
    return room


@device
def list_rays(groups, count, memory, t_in, rays):
    """List the rays of a list of groups without a hit before t_in; returns their number."""
    kept = ZERO_U64
    for j in range(count):
        packed = np.uint64(load(np.uint32, groups + j * LANE))
        g = packed >> GROUP_SHIFT
        inside = lanes_from_bits(mask16, packed & RAY_BITS) & (Group(memory, g).t >= t_in)
        numbers = lane_numbers(i32x16) + np.int32(g << LANE_SHIFT)
        store(rays + kept * LANE, compress(inside, numbers))
        kept += popcount(mask_bits(inside))
    return kept


@device
def _still_wanted(rays, count, memory, t_in):
    """Remove the rays of a list with a hit before `t_in`; returns its new length."""
    kept = ZERO_U64
    for j in range(count):
        ray = load(np.uint32, rays + j * LANE)
        store(rays + kept * LANE, ray)
        kept += np.uint64(Hot(memory + HOT_AT, np.uint64(ray)).t >= t_in)
    return kept


class RayList(NamedTuple):
    """The rays that reach a leaf.

    Attributes
    ----------
    at, length : uint64
        Address and length of a list of rays, or of groups.
    is_grouped : bool
    t_in : float32
        No ray enters before.
    room : uint64
        Address of memory behind all lists in use.
    """

    at: np.uint64
    length: np.uint64
    is_grouped: bool
    t_in: np.float32
    room: np.uint64


def group_walk():
    """Make the function that traces groups: one for each level of trees, as none calls itself.

    Returns
    -------
    device function
        ``trace_block(memory, groups, count, ray_count, tree, stack, small, leaf)``, see there.
    """

    @device
    def trace_block(memory, groups, count, ray_count, tree, stack, small, leaf):
        """Trace the groups of a list.

        Parameters
        ----------
        memory : uint64
            Address of the block, see `group_rays`.
        groups : uint64
            Address of the list, with memory for all others behind it.
        count, ray_count : uint64
            Its length, and the rays in it.
        tree : NamedTuple
            With addresses of ``nodes`` and ``leaves``.
        stack : uint64
            Address of `STREAM_STACK_BYTES` bytes.
        small : view of ray_groups.leaf.Small
        leaf : NamedTuple
            What leaves are, and what becomes of their hits. It has a device function
            ``visit(leaf, tree, child, rays, memory, small)`` that finds the hits of a `RayList` in
            a leaf; returns their number.
        """
        lanes = SmallLanes(address_of(small))
        hits = memory + HITS_AT
        hit_count = ZERO_U64
        root = _Entry(stack)
        root.child, root.count, root.list = np.int32(0), np.uint32(count), groups
        root.room, root.t_in = groups + (count + _LANES) * LANE, -INF_F32
        root.hit_count, root.ray_count = np.uint32(0), ray_count
        top = np.uint64(count != ZERO_U64)
        while top != ZERO_U64:
            top -= ONE_U64
            entry = _Entry(stack, top)
            child, at, length, room = entry.child, entry.list, np.uint64(entry.count), entry.room
            is_grouped = entry.ray_count >= length * _FEW
            if not is_grouped:
                if entry.ray_count != ZERO_U64:
                    length = list_rays(at, length, memory, entry.t_in, room)
                    at = room
                    room += length * LANE
                elif entry.hit_count != np.uint32(hit_count):
                    length = _still_wanted(at, length, memory, entry.t_in)
                if length == ZERO_U64:
                    continue
            if child < np.int32(0):
                rays = RayList(at, length, is_grouped, entry.t_in, room)
                hit_count += leaf.visit(leaf, tree, child, rays, memory, small)
                continue
            number = np.uint64(child)
            if is_grouped:
                room = _visit_with_groups(
                    NodeLanes(tree.nodes, number), at, length, memory, small, lanes, room
                )
            else:
                room = _visit_with_rays(
                    Node(tree.nodes, number), at, length, memory, small, lanes, hits, room
                )
            node = NodeLanes(tree.nodes, number)
            top = _push(stack, top, node, small, lanes, room, hit_count, tree)

    return trace_block


trace_block = group_walk()
