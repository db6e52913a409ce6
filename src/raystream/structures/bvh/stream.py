"""Streams of rays of one octant: the kernel for large incoherent batches.

A stream of some hundred rays traverses the tree together, as a list of ray indices. At a node
the eight boxes are loaded once; each ray of the list is tested against all of them, and appended to
the lists of the children that it enters, which are visited from the nearest to the farthest. Rays
have no stack or order of their own: compared with single rays, there is no sorting or stack per
ray, there are no unpredictable branches, and a node's memory latency is paid once. In a leaf each
ray of the list is tested against four triangles at once.

References
----------
Tsakok, "Faster Incoherent Rays: Multi-BVH Ray Stream Tracing", High Performance Graphics
2009; Fuetterling et al., "Efficient Ray Tracing Kernels for Modern CPU Architectures", Journal
of Computer Graphics Techniques 4(4), 2015.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    any_lane,
    compress,
    count_trailing_zeros,
    f32x8,
    float_as_bits,
    i32x8,
    i32x16,
    lane_numbers,
    load,
    mask_bits,
    maximum,
    minimum,
    popcount,
    scratch,
    select,
    store,
)
from raystream.jit.views import address_of, view
from raystream.kernels.hit_filter import HitFilter, RayFilter, any_kept, keeps
from raystream.kernels.leaf_block import BLOCK, HITS, Block, HitLanes
from raystream.kernels.triangle_lanes import (
    barycentrics,
    plane_distance,
    shear_vertices,
    signs_agree,
    slab_interval,
)
from raystream.structures.bvh.layout import MAX_DEPTH, STACK_SIZE
from raystream.structures.bvh.node_layout import (
    KEY_LANES,
    LANE,
    Node,
    NodeLanes,
    leaf_address,
    leaf_end,
    prefetch_child,
    sort_keys,
)
from raystream.structures.bvh.stream_rays import (
    FILL_BYTES,
    STREAM_BYTES,
    STREAM_RAYS,
    Cold,
    Fill,
    Hot,
    fill,
    scale_of,
    stream_rays,
    write_results,
)

__all__ = ["CALL_BYTES", "trace_streams"]

#: Entry distances and keys of a node's children, and hits of a block; and the former with a lane
#: index.
_SMALL = np.dtype([("t_in", "f4", 8), ("keys", "i4", 8), ("hits", HITS)])
_Small = view(_SMALL)
_SmallLanes = view([("t_in", "f4", (8, 1)), ("keys", "i4", (8, 1))])
_SMALL_BYTES = _SMALL.itemsize

_U0, _U1, _U2, _U4 = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(4)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_FIRST, _SECOND, _THIRD = np.uint64(0), np.uint64(1), np.uint64(2)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_KEY_BITS = np.int32(~7)
_LEAST_KEY = np.int32(-(2**31))
_LANES = np.uint64(16)

_CAPACITY = np.uint64(STREAM_RAYS)
_OCTANTS = np.uint64(8)
_HIT_BYTES = 4 * STREAM_RAYS + 64

#: A stack entry: a child, the length and the address of its list of rays, the least distance at
#: which one enters it, and the number of hits when it was pushed.
_ENTRY = np.dtype(
    [("child", "i4"), ("count", "u4"), ("rays", "u8"), ("t_in", "f4"), ("hit_count", "u4")]
)
_Entry = view(_ENTRY)
_STACK_BYTES = _ENTRY.itemsize * (STACK_SIZE + 8)

#: Bytes of all lists: a list and its eight children's on each level of the tree, each with room for
#: the 16 lanes that are always stored.
_LIST_BYTES = 4 * (MAX_DEPTH + 1) * 9 * (STREAM_RAYS + 16)

#: Memory of a call of `trace_streams`.
CALL_BYTES = STREAM_BYTES + _LIST_BYTES + 64


@device
def _still_wanted(rays, count, hot, t_in):
    """Remove the rays of a list with a hit before `t_in`; returns its new length."""
    kept = _U0
    for j in range(count):
        ray = load(np.uint32, rays + j * LANE)
        store(rays + kept * LANE, ray)
        kept += np.uint64(Hot(hot, np.uint64(ray)).t >= t_in)
    return kept


@device
def _visit_node(node, rays, count, hot, x, y, z, hits):
    """Test the rays of a list against a node's eight boxes.

    Writes the children that each ray enters as bits to `hits`; returns the least distance at which
    each child is entered. `x`, `y`, `z` are the rows of the planes that rays enter by.
    """
    planes = node.planes
    low_x, high_x = planes[x], planes[x ^ _U1]
    low_y, high_y = planes[y], planes[y ^ _U1]
    low_z, high_z = planes[z], planes[z ^ _U1]
    least = f32x8(_INF)
    for j in range(count):
        ray = Hot(hot, np.uint64(load(np.uint32, rays + j * LANE)))
        t_in, t_out = slab_interval(
            low_x, low_y, low_z, high_x, high_y, high_z, ray.inv, ray.near, ray.far
        )
        entered = maximum(t_in, ray.t_min) <= minimum(t_out, ray.t)
        least = select(entered, minimum(t_in, least), least)
        store(hits + j * LANE, np.uint32(mask_bits(entered)))
    # `_make_list` reads 16 at a time: bits behind the list must be 0.
    store(hits + count * LANE, i32x16(np.int32(0)))
    return least


@device
def _make_list(to, rays, hits, count, lane):
    """Write the rays of a list that enter a child; returns their number."""
    bit = i32x16(np.int32(_U1 << lane))
    zero = i32x16(np.int32(0))
    written = _U0
    for j in range(_U0, count, _LANES):
        at = j * LANE
        enters = (load(i32x16, hits + at) & bit) != zero
        store(to + written * LANE, compress(enters, load(i32x16, rays + at)))
        written += popcount(mask_bits(enters))
    return written


@device
def _axes(hot):
    """The axes of a ray's frame."""
    kx, ky, kz = hot.axes
    return np.uint64(kx), np.uint64(ky), np.uint64(kz)


@device
def _vertices(hot, block):
    """The vertices of a block's four triangles, in the order of a ray's axes."""
    x, y, z = _axes(hot)
    corners = block.corners
    a = corners[_FIRST, x], corners[_FIRST, y], corners[_FIRST, z]
    b = corners[_SECOND, x], corners[_SECOND, y], corners[_SECOND, z]
    c = corners[_THIRD, x], corners[_THIRD, y], corners[_THIRD, z]
    return a, b, c


@device
def _sheared(hot, cold, block):
    """The vertices of a block's four triangles in a ray's frame."""
    return shear_vertices(*_vertices(hot, block), hot.origin, (hot.sx, cold.sy))


@device
def _distances(hot, cold, block):
    return plane_distance(*_vertices(hot, block), hot.origin, cold.direction)


class StreamFilter(NamedTuple):
    """The filter of a stream's rays.

    Attributes
    ----------
    filter : HitFilter
    first : uint64
        The batch index of number 0.
    numbers : uint64
        Address of the rays' numbers, uint32.
    """

    filter: HitFilter
    first: np.uint64
    numbers: np.uint64


@device
def _filter_from(filter_, rays, place):
    """The `StreamFilter` of `SortedRays` from a place on; None without a filter."""
    if filter_ is None:
        return None
    return StreamFilter(filter_, rays.first, rays.numbers + place * LANE)


@device
def _test_block(rays, count, stream, block, backward, hits, lanes, wants_any, filter_):
    """Test the rays of a list against a block of triangles; returns the number of hits."""
    # Step 1: compact the rays whose edge functions agree in sign, without branches. (With one per
    # ray, mispredictions would take half the time of a leaf.)
    candidate_count = _U0
    for j in range(count):
        number = load(np.uint32, rays + j * LANE)
        hot, cold = Hot(stream.hot, np.uint64(number)), Cold(stream.cold, np.uint64(number))
        store(hits + candidate_count * LANE, number)
        candidate_count += np.uint64(any_lane(signs_agree(_sheared(hot, cold, block))))
    if candidate_count == _U0:
        return _U0

    # Step 2: test these exactly.
    hit_count = _U0
    back_x, back_y, back_z = backward
    low_x, high_x = _extent(block, _X)
    low_y, high_y = _extent(block, _Y)
    low_z, high_z = _extent(block, _Z)
    near_x, far_x = select(back_x, high_x, low_x), select(back_x, low_x, high_x)
    near_y, far_y = select(back_y, high_y, low_y), select(back_y, low_y, high_y)
    near_z, far_z = select(back_z, high_z, low_z), select(back_z, low_z, high_z)
    for j in range(candidate_count):
        number = np.uint64(load(np.uint32, hits + j * LANE))
        hot, cold = Hot(stream.hot, number), Cold(stream.cold, number)
        t_in, t_out = slab_interval(
            near_x,
            near_y,
            near_z,
            far_x,
            far_y,
            far_z,
            hot.inv,
            hot.near,
            hot.far,
        )
        nearest, t_min = hot.t, hot.t_min
        sheared = _sheared(hot, cold, block)
        candidates = signs_agree(sheared) & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
        if any_lane(candidates):
            # The distance first: rays that leave a surface meet its triangle behind their
            # origin, and need no barycentrics.
            t = minimum(maximum(_distances(hot, cold, block), t_in), t_out) + _ZERO
            candidates = candidates & (t >= t_min) & (t <= nearest)
            if not any_lane(candidates):
                continue
            hit, u, v = barycentrics(sheared, False)
            bits = mask_bits(candidates & hit)
            if bits != _U0:
                lanes.t, lanes.u, lanes.v = t, u, v
                of_lane, of_ray = HitLanes(address_of(lanes)), _filter_of(filter_, stream, number)
                if not wants_any:
                    hit_count += _keep_nearest(hot, cold, block, bits, of_lane, of_ray)
                elif any_kept(of_ray, block, bits, of_lane):
                    hit_count += _U1
                    cold.prim_id, hot.t = np.int32(0), -_INF
    return hit_count


@device
def _extent(block, axis):
    """Low and high coordinates of four triangles along an axis."""
    corners = block.corners
    a, b, c = corners[_FIRST, axis], corners[_SECOND, axis], corners[_THIRD, axis]
    return minimum(minimum(a, b), c), maximum(maximum(a, b), c)


@device
def _filter_of(filter_, stream, number):
    """The `RayFilter` of a ray of a stream, for a `StreamFilter`; None without one."""
    if filter_ is None:
        return None
    index = filter_.first + np.uint64(load(np.uint32, filter_.numbers + number * LANE))
    t_scale, t_offset = scale_of(stream, number)
    return RayFilter(filter_.filter, index, t_scale, t_offset)


@device
def _keep_nearest(hot, cold, block, bits, lanes, filter_):
    """Keep the nearest of the ray's hit and the hits of some lanes, by t, then prim_id.

    Returns 1 if it changed, else 0.
    """
    nearest, best, changes = hot.t, cold.prim_id, _U0
    while bits != _U0:
        lane = count_trailing_zeros(bits)
        bits &= bits - _U1
        t, prim_id = lanes.t[lane], block.prim_ids[lane]
        u, v = lanes.u[lane], lanes.v[lane]
        is_nearer = t < nearest or (t == nearest and prim_id < best)
        if is_nearer and keeps(filter_, t, u, v, prim_id):
            nearest, best, changes = t, prim_id, _U1
            cold.u, cold.v = u, v
    hot.t, cold.prim_id = nearest, best
    return changes


@device
def _trace_stream(octant, count, stream, tree, stack, lists, hits, small, wants_any, filter_):
    """Trace the rays of a stream."""
    back_x, back_y, back_z = octant & _U1, (octant >> _U1) & _U1, octant >> _U2
    backward = back_x != _U0, back_y != _U0, back_z != _U0
    x, y, z = back_x, _U2 | back_y, _U4 | back_z
    of_lane = _SmallLanes(address_of(small))
    for j in range(count):
        store(lists + j * LANE, np.uint32(j))

    hit_count = _U0
    root = _Entry(stack)
    root.child, root.count, root.rays = np.int32(0), np.uint32(count), lists
    root.t_in, root.hit_count = -_INF, np.uint32(hit_count)
    top = _U1
    while top != _U0:
        top -= _U1
        entry = _Entry(stack, top)
        child, rays, length = entry.child, entry.rays, np.uint64(entry.count)
        if entry.hit_count != np.uint32(hit_count):
            length = _still_wanted(rays, length, stream.hot, entry.t_in)
            if length == _U0:
                continue
        if child < np.int32(0):
            at = leaf_address(tree.leaves, child)
            end = leaf_end(at, child)
            while at != end:
                hit_count += _test_block(
                    rays, length, stream, Block(at), backward, hits, small.hits, wants_any, filter_
                )
                at += BLOCK
            continue
        number = np.uint64(child)
        t_in = _visit_node(Node(tree.nodes, number), rays, length, stream.hot, x, y, z, hits)
        entered = t_in < _INF
        if not any_lane(entered):
            continue
        # Push the children with their lists, the farthest first.
        key = (float_as_bits(maximum(t_in, _ZERO)) & _KEY_BITS) | lane_numbers(i32x8)
        small.t_in, small.keys = t_in, sort_keys(select(entered, key, i32x8(_LEAST_KEY)))
        children = NodeLanes(tree.nodes, number).children
        room = rays + length * LANE
        for k in range(popcount(mask_bits(entered))):
            lane = np.uint64(of_lane.keys[k] & KEY_LANES)
            prefetch_child(children[lane], tree.nodes, tree.leaves)
            written = _make_list(room, rays, hits, length, lane)
            entry = _Entry(stack, top)
            entry.child, entry.count, entry.rays = children[lane], np.uint32(written), room
            entry.t_in, entry.hit_count = of_lane.t_in[lane], np.uint32(hit_count)
            top += _U1
            room += written * LANE


@kernel
def trace_streams(begin, end, tree, frame, source, rays, wants_any, filter_, out):
    """Trace sorted rays begin to end.

    Parameters
    ----------
    begin, end : int
    tree : TreeAddresses
        Not empty.
    frame : SceneFrame
    source : RaySource
    rays : SortedRays
        By octant. Nearest hits are written to their rows.
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    filter_ : HitFilter or None
    out : ResultAddresses
        Written, except for nearest hits.
    """
    memory = np.empty(STREAM_BYTES + _LIST_BYTES + 64, np.uint8)
    stream = stream_rays((address(memory) + np.uint64(63)) & ~np.uint64(63))
    lists = stream.hot + np.uint64(STREAM_BYTES)
    group = Fill(scratch(FILL_BYTES))
    stack = scratch(_STACK_BYTES)
    hits = scratch(_HIT_BYTES)
    small = _Small(scratch(_SMALL_BYTES))

    at = np.uint64(begin)
    for octant in range(_OCTANTS):
        octant_end = load(np.uint64, rays.octant_ends + octant * _OCTANTS)
        while at < min(octant_end, np.uint64(end)):
            count = min(min(octant_end, np.uint64(end)) - at, _CAPACITY)
            fill(stream, source, rays, at, count, frame, group, out.status)
            mine = _filter_from(filter_, rays, at)
            _trace_stream(octant, count, stream, tree, stack, lists, hits, small, wants_any, mine)
            write_results(stream, rays, at, count, wants_any, out)
            at += count
    # The memory must outlive its addresses.
    memory[0] = np.uint8(0)
