"""Single rays, prepared 16 at a time: the kernel for rays that share few nodes."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    any_lane,
    compress,
    count_trailing_zeros,
    f32x8,
    f32x16,
    float_as_bits,
    i32x8,
    i32x16,
    lane_numbers,
    load,
    mask_bits,
    maximum,
    minimum,
    permute,
    popcount,
    scratch,
    select,
    store,
    store_records,
)
from raystream.jit.views import address_of, view
from raystream.kernels.leaf_block import (
    AXIS,
    BLOCK,
    HITS,
    Block,
    BlockLanes,
    BlockRay,
    HitLanes,
    test_block,
)
from raystream.kernels.triangle_lanes import (
    barycentrics,
    plane_distance,
    shear_vertices,
    signs_agree,
    slab_interval,
)
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import (
    BOX_FLIP,
    CHILDREN,
    LANE,
    NODE,
    NodeLanes,
    leaf_address,
    leaf_end,
    plane_offset,
    prefetch_child,
    sort_keys,
    t_key,
)
from raystream.structures.bvh.packet_load import load_group
from raystream.structures.bvh.packet_rays import (
    GROUP,
    NO_PRIM,
    Group,
    GroupLanes,
    store_group,
    three,
)

__all__ = ["trace_hybrid"]

_U0, _U1 = np.uint64(0), np.uint64(1)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_LANES = np.uint64(16)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_KEY_BITS = np.int32(~7)
_NO_KEY = np.int32(-1)

_GROUP_BYTES = GROUP.itemsize
_STACK = 4 * (STACK_SIZE + 16)
_HITS_BYTES = HITS.itemsize
_STACK_BYTES = 2 * _STACK
_ROOM = view([("t_in", "f4", (8, 1)), ])
_ROOM_V = view([("t_in", "f4", 8), ])


@device
def _closest(tree, lanes, k, child, stack, room, hits, prefetching):
    """Trace one ray."""
    kz = np.uint64(lanes.direction_class[k] & np.int32(3))
    kx = kz + _U1 if kz < _Z else _U0
    ky = kx + _U1 if kx < _Z else _U0
    inv, near, far = lanes.inv, lanes.near, lanes.far
    o, d, s = lanes.origin, lanes.direction, lanes.shear
    ray_inv = inv[_X, k], inv[_Y, k], inv[_Z, k]
    ray_near = near[_X, k], near[_Y, k], near[_Z, k]
    ray_far = far[_X, k], far[_Y, k], far[_Z, k]
    at_x = plane_offset(_X, ray_inv[0])
    at_y = plane_offset(_Y, ray_inv[1])
    at_z = plane_offset(_Z, ray_inv[2])
    line = BlockRay(
        (kx * AXIS, ky * AXIS, kz * AXIS),
        (inv[kx, k], inv[ky, k], inv[kz, k]),
        (near[kx, k], near[ky, k], near[kz, k]),
        (far[kx, k], far[ky, k], far[kz, k]),
        (o[kx, k], o[ky, k], o[kz, k]),
        (d[kx, k], d[ky, k], d[kz, k]),
        (s[_X, k], s[_Y, k], s[_Z, k]),
    )
    t_min, t = lanes.t_min[k], lanes.t[k]
    limit = t_key(t)
    prim_id, u, v = lanes.prim_id[k], lanes.u[k], lanes.v[k]
    keys, children = stack, stack + np.uint64(_STACK)
    top = _U0
    t_ins = _ROOM(room).t_in
    while True:
        if child >= np.int32(0):
            node = tree.nodes + np.uint64(child) * NODE
            t_in, t_out = slab_interval(
                load(f32x8, node + at_x),
                load(f32x8, node + at_y),
                load(f32x8, node + at_z),
                load(f32x8, node + (at_x ^ BOX_FLIP)),
                load(f32x8, node + (at_y ^ BOX_FLIP)),
                load(f32x8, node + (at_z ^ BOX_FLIP)),
                ray_inv,
                ray_near,
                ray_far,
            )
            t_in = maximum(t_in, t_min)
            entered = t_in <= minimum(t_out, t)
            bits = mask_bits(entered)
            if bits != _U0:
                first = count_trailing_zeros(bits)
                rest = bits & (bits - _U1)
                links = node + CHILDREN
                child = load(np.int32, links + first * LANE)
                if rest == _U0:
                    if prefetching:
                        prefetch_child(child, tree.nodes, tree.leaves)
                    continue
                second = count_trailing_zeros(rest)
                more = rest & (rest - _U1)
                key = float_as_bits(maximum(t_in, _ZERO))
                if more == _U0:
                    store(room, key)
                    other = load(np.int32, links + second * LANE)
                    key_1 = load(np.int32, room + first * LANE)
                    key_2 = load(np.int32, room + second * LANE)
                    swap = key_2 < key_1
                    store(keys + top, key_1 if swap else key_2)
                    store(children + top, child if swap else other)
                    child = other if swap else child
                    top += LANE
                    if prefetching:
                        prefetch_child(child, tree.nodes, tree.leaves)
                    continue
                key = (key & _KEY_BITS) | lane_numbers(i32x8)
                key = sort_keys(select(entered, key, i32x8(_NO_KEY)))
                store(keys + top, key)
                store(children + top, permute(load(i32x8, links), key))
                top += (popcount(bits) - _U1) << np.uint64(2)
                child = load(np.int32, children + top)
                if prefetching:
                    prefetch_child(child, tree.nodes, tree.leaves)
                continue
        else:
            at = leaf_address(tree.leaves, child)
            end = leaf_end(at, child)
            while at != end:
                found = test_block(at, line, t_min, t, False, hits)
                if found != _U0:
                    block, of = Block(at), HitLanes(hits)
                    while found != _U0:
                        lane = count_trailing_zeros(found)
                        found &= found - _U1
                        t_hit, hit_id = of.t[lane], block.prim_ids[lane]
                        if t_hit < t or (t_hit == t and hit_id < prim_id):
                            t, prim_id = t_hit, hit_id
                            u, v = of.u[lane], of.v[lane]
                    limit = t_key(t)
                at += BLOCK
        while top != _U0:
            top -= LANE
            if load(np.int32, keys + top) <= limit:
                break
        else:
            break
        child = load(np.int32, children + top)
    lanes.t[k], lanes.prim_id[k], lanes.u[k], lanes.v[k] = t, prim_id, u, v


@device
def _any(tree, lanes, k, child, stack, hits, prefetching):
    """Trace one ray."""
    kz = np.uint64(lanes.direction_class[k] & np.int32(3))
    kx = kz + _U1 if kz < _Z else _U0
    ky = kx + _U1 if kx < _Z else _U0
    inv, near, far = lanes.inv, lanes.near, lanes.far
    o, d, s = lanes.origin, lanes.direction, lanes.shear
    ray_inv = inv[_X, k], inv[_Y, k], inv[_Z, k]
    ray_near = near[_X, k], near[_Y, k], near[_Z, k]
    ray_far = far[_X, k], far[_Y, k], far[_Z, k]
    at_x = plane_offset(_X, ray_inv[0])
    at_y = plane_offset(_Y, ray_inv[1])
    at_z = plane_offset(_Z, ray_inv[2])
    line = BlockRay(
        (kx * AXIS, ky * AXIS, kz * AXIS),
        (inv[kx, k], inv[ky, k], inv[kz, k]),
        (near[kx, k], near[ky, k], near[kz, k]),
        (far[kx, k], far[ky, k], far[kz, k]),
        (o[kx, k], o[ky, k], o[kz, k]),
        (d[kx, k], d[ky, k], d[kz, k]),
        (s[_X, k], s[_Y, k], s[_Z, k]),
    )
    t_min, t = lanes.t_min[k], lanes.t[k]
    children = stack
    top = _U0
    while True:
        if child >= np.int32(0):
            node = tree.nodes + np.uint64(child) * NODE
            t_in, t_out = slab_interval(
                load(f32x8, node + at_x),
                load(f32x8, node + at_y),
                load(f32x8, node + at_z),
                load(f32x8, node + (at_x ^ BOX_FLIP)),
                load(f32x8, node + (at_y ^ BOX_FLIP)),
                load(f32x8, node + (at_z ^ BOX_FLIP)),
                ray_inv,
                ray_near,
                ray_far,
            )
            entered = maximum(t_in, t_min) <= minimum(t_out, t)
            bits = mask_bits(entered)
            store(children + top, compress(entered, load(i32x8, node + CHILDREN)))
            top += popcount(bits) << np.uint64(2)
        else:
            at = leaf_address(tree.leaves, child)
            end = leaf_end(at, child)
            while at != end:
                if test_block(at, line, t_min, t, False, hits) != _U0:
                    lanes.prim_id[k], lanes.t[k] = np.int32(0), -_INF
                    return
                at += BLOCK
        if top == _U0:
            return
        top -= LANE
        child = load(np.int32, children + top)


#: A packet's rays in the order of their frames.
_FRAME = np.dtype([("origin", "f4", (3, 16)), ("direction", "f4", (3, 16))])
_Frame = view(_FRAME)
_FRAME_BYTES = _FRAME.itemsize
#: A stack entry.
_ENTRY = np.dtype([("t_in", "f4", 16), ("child", "i4"), ("unused", "V60")])
_Entry = view(_ENTRY)
_ENTRIES_BYTES = _ENTRY.itemsize * (STACK_SIZE + 8)
_NAN = np.float32(np.nan)
_THRESHOLD = np.uint64(8)


@device
def _in_frame(is_y, is_z, x, y, z):
    return (
        select(is_z, x, select(is_y, z, y)),
        select(is_z, y, select(is_y, x, z)),
        select(is_z, z, select(is_y, y, x)),
    )


@device
def _corner_in_frame(is_y, is_z, corners, corner, lane):
    return _in_frame(
        is_y,
        is_z,
        f32x16(corners[corner, _X, lane]),
        f32x16(corners[corner, _Y, lane]),
        f32x16(corners[corner, _Z, lane]),
    )


@device
def _extent(corners, axis, lane):
    a, b, c = corners[_X, axis, lane], corners[_Y, axis, lane], corners[_Z, axis, lane]
    return f32x16(min(min(a, b), c)), f32x16(max(max(a, b), c))


@device
def _interval(group, low_x, high_x, low_y, high_y, low_z, high_z):
    inv = three(group.inv)
    back_x, back_y, back_z = inv[0] < _ZERO, inv[1] < _ZERO, inv[2] < _ZERO
    return slab_interval(
        select(back_x, high_x, low_x),
        select(back_y, high_y, low_y),
        select(back_z, high_z, low_z),
        select(back_x, low_x, high_x),
        select(back_y, low_y, high_y),
        select(back_z, low_z, high_z),
        inv,
        three(group.near),
        three(group.far),
    )


@device
def _test_triangle(group, frame, block, lane, wants_any):
    """Test a triangle against 16 rays; returns whether any has a nearer hit."""
    kinds = group.direction_class & np.int32(3)
    is_y, is_z = kinds == np.int32(1), kinds == np.int32(2)
    corners = block.corners
    a = _corner_in_frame(is_y, is_z, corners, _X, lane)
    b = _corner_in_frame(is_y, is_z, corners, _Y, lane)
    c = _corner_in_frame(is_y, is_z, corners, _Z, lane)
    origin, shear = three(frame.origin), group.shear
    sheared = shear_vertices(a, b, c, origin, (shear[_X], shear[_Y]))
    candidates = signs_agree(sheared)
    if not any_lane(candidates):
        return False
    low_x, high_x = _extent(corners, _X, lane)
    low_y, high_y = _extent(corners, _Y, lane)
    low_z, high_z = _extent(corners, _Z, lane)
    t_in, t_out = _interval(group, low_x, high_x, low_y, high_y, low_z, high_z)
    nearest, t_min = group.t, group.t_min
    candidates = candidates & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
    if not any_lane(candidates):
        return False
    t = plane_distance(a, b, c, origin, three(frame.direction))
    t = minimum(maximum(t, t_in), t_out) + _ZERO
    candidates = candidates & (t >= t_min) & (t <= nearest)
    if not any_lane(candidates):
        return False
    hit, u, v = barycentrics(sheared, False)
    prim_id, best = i32x16(block.prim_ids[lane]), group.prim_id
    taken = candidates & hit & ((t < nearest) | (prim_id < best))
    if not any_lane(taken):
        return False
    group.prim_id = select(taken, prim_id, best)
    if wants_any:
        group.t = select(taken, f32x16(-_INF), nearest)
        return True
    group.t = select(taken, t, nearest)
    group.u, group.v = select(taken, u, group.u), select(taken, v, group.v)
    return True


@device
def _trace_group(tree, memory, frame, entries, stack, room, hits, wants_any, prefetching):
    group, lanes = Group(memory), GroupLanes(memory)
    child = np.int32(0)
    active = mask_bits(group.t_min <= group.t)
    top = _U0
    while True:
        if active == _U0:
            pass
        elif popcount(active) < _THRESHOLD:
            while active != _U0:
                k = count_trailing_zeros(active)
                active &= active - _U1
                if wants_any:
                    _any(tree, lanes, k, child, stack, hits, prefetching)
                else:
                    _closest(tree, lanes, k, child, stack, room, hits, prefetching)
        elif child >= np.int32(0):
            node = NodeLanes(tree.nodes, np.uint64(child))
            planes, children = node.planes, node.children
            near = f32x16(_NAN)
            active = _U0
            for lane in range(np.uint64(8)):
                link = children[lane]
                if link == np.int32(0):
                    break
                t_in, t_out = _interval(
                    group,
                    f32x16(planes[np.uint64(0), lane]),
                    f32x16(planes[np.uint64(1), lane]),
                    f32x16(planes[np.uint64(2), lane]),
                    f32x16(planes[np.uint64(3), lane]),
                    f32x16(planes[np.uint64(4), lane]),
                    f32x16(planes[np.uint64(5), lane]),
                )
                t_in = maximum(t_in, group.t_min)
                entered = t_in <= minimum(t_out, group.t)
                bits = mask_bits(entered)
                if bits == _U0:
                    continue
                if prefetching:
                    prefetch_child(link, tree.nodes, tree.leaves)
                t_in = select(entered, t_in, f32x16(_NAN))
                if active == _U0:
                    child, near, active = link, t_in, bits
                    continue
                entry = _Entry(entries, top)
                top += _U1
                if any_lane(t_in < near):
                    entry.child, entry.t_in = child, near
                    child, near, active = link, t_in, bits
                else:
                    entry.child, entry.t_in = link, t_in
            if active != _U0:
                continue
        else:
            at = leaf_address(tree.leaves, child)
            end = leaf_end(at, child)
            while at != end:
                block = BlockLanes(at)
                for lane in range(np.uint64(4)):
                    if block.prim_ids[lane] < np.int32(0):
                        break
                    _test_triangle(group, frame, block, lane, wants_any)
                at += BLOCK
        active = _U0
        while top != _U0 and active == _U0:
            top -= _U1
            entry = _Entry(entries, top)
            child = entry.child
            active = mask_bits(entry.t_in <= group.t)
        if active == _U0:
            return


@kernel
def trace_hybrid(begin, end, tree, frame, source, wants_any, prefetching, out):
    """Trace rays begin to end."""
    memory = scratch(_GROUP_BYTES)
    in_frame = _Frame(scratch(_FRAME_BYTES))
    entries = scratch(_ENTRIES_BYTES)
    stack = scratch(_STACK_BYTES)
    room = scratch(64)
    hits = scratch(_HITS_BYTES)
    group = Group(memory)
    for first in range(np.uint64(begin), np.uint64(end), _LANES):
        count = min(np.uint64(end) - first, _LANES)
        is_slow = load_group(group, first, count, source, frame, out.status)
        kinds = group.direction_class & np.int32(3)
        is_y, is_z = kinds == np.int32(1), kinds == np.int32(2)
        ox, oy, oz = three(group.origin)
        dx, dy, dz = three(group.direction)
        origin, direction = in_frame.origin, in_frame.direction
        origin[_X], origin[_Y], origin[_Z] = _in_frame(is_y, is_z, ox, oy, oz)
        direction[_X], direction[_Y], direction[_Z] = _in_frame(is_y, is_z, dx, dy, dz)
        _trace_group(tree, memory, in_frame, entries, stack, room, hits, wants_any, prefetching)
        store_group(memory, first, count, is_slow, wants_any, out)
