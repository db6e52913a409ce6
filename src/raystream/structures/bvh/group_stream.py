"""Streams of groups: the kernel for incoherent rays that start near each other.

Rays in the order of the batch are loaded as groups of 16, one vector per number. A list of groups
descends the tree, from the root, with the rays of each group that are in a box as bits: a box is
tested against 16 rays at once, in any direction. Where few rays of a group are left, the list is
expanded to a list of single rays; each of these is tested against the eight boxes of a node, as in
`stream`. Nothing is sorted, and results are written 16 at a time.

References
----------
Tsakok, "Faster Incoherent Rays: Multi-BVH Ray Stream Tracing", High Performance Graphics
2009; Benthin, Wald, Woop, Ernst and Mark, "Combining Single and Packet-Ray Tracing for Arbitrary
Ray Distributions on the Intel MIC Architecture", IEEE TVCG 18(9), 2012.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    address,
    any_lane,
    bits_as_float,
    compress,
    count_trailing_zeros,
    f32x8,
    f32x16,
    f64x16,
    float_as_bits,
    fma,
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
    scratch,
    select,
    store,
    store_records,
)
from raystream.jit.views import address_of, view
from raystream.kernels.leaf_block import BLOCK, HITS, Block, BlockLanes, HitLanes
from raystream.kernels.triangle_lanes import (
    barycentrics,
    distance_along,
    plane_normal,
    shear_vertices,
    signs_agree,
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
from raystream.structures.bvh.packet_load import load_group
from raystream.structures.bvh.packet_rays import (
    GROUP,
    GROUPS,
    PACKET_RAYS,
    Group,
    GroupLanes,
    group_rows,
    store_group,
    three,
)

__all__ = ["BLOCK_PACKETS", "trace_groups"]

#: Most rays of a block: all that descend the tree together.
BLOCK_RAYS = 8192
#: The same in packets.
BLOCK_PACKETS = BLOCK_RAYS // PACKET_RAYS
_PACKETS = np.uint64(BLOCK_PACKETS)
_GROUPS = BLOCK_RAYS // 16

#: Fewer rays than this per group, on average, continue as single rays.
_FEW = np.uint64(10)

_U0, _U1, _U2, _U3 = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_FIRST, _SECOND, _THIRD = np.uint64(0), np.uint64(1), np.uint64(2)
_LANES, _WIDTH, _BLOCK_LANES = np.uint64(16), np.uint64(8), np.uint64(4)
_HALF = np.uint64(16)
_LOW = np.uint64(0xFFFF)
_LANE_SHIFT = np.uint64(4)
_LAST_LANE = np.uint64(15)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_KEY_BITS = np.int32(~7)
_LEAST_KEY = np.int32(-(2**31))

#: A ray for nodes and the signs of a leaf; the origin and the shear are in the order of its frame.
_HOT = np.dtype(
    [
        ("inv", "f4", 3),
        ("low", "f4", 3),
        ("high", "f4", 3),
        ("t_min", "f4"),
        ("t", "f4"),
        ("origin", "f4", 3),
        ("axes", "u1", 3),  # kx, ky, kz
        ("unused", "u1"),
        ("sx", "f4"),
    ]
)
_Hot = view(_HOT)
#: What only leaves need: the direction in the order of the frame, and the shear's second number.
_COLD = np.dtype([("direction", "f4", 3), ("sy", "f4")])
_Cold = view(_COLD)
_HOT_BYTES, _COLD_BYTES = np.uint64(_HOT.itemsize), np.uint64(_COLD.itemsize)

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
_STACK_BYTES = _ENTRY.itemsize * (STACK_SIZE + 8)

#: Children of a node and their lists; hits of a block; normals of its triangles.
_SMALL = np.dtype(
    [
        ("list", "u8", 8),
        ("count", "u8", 8),
        ("ray_count", "u8", 8),
        ("normal", "f8", (3, 4)),
        ("t_in", "f4", 8),
        ("keys", "i4", 8),
        ("hits", HITS),
        ("unused", "V48"),
    ]
)
_Small = view(_SMALL)
_SmallLanes = view(
    [
        ("list", "u8", (8, 1)),
        ("count", "u8", (8, 1)),
        ("ray_count", "u8", (8, 1)),
        ("normal", "f8", (3, 4, 1)),
        ("t_in", "f4", (8, 1)),
        ("keys", "i4", (8, 1)),
        ("hits", HITS),
        ("unused", "V48"),
    ]
)
_SMALL_BYTES = _SMALL.itemsize

_GROUP_BYTES = np.uint64(GROUP.itemsize)
_HOT_AT = np.uint64(_GROUPS * GROUP.itemsize)
_COLD_AT = _HOT_AT + np.uint64(BLOCK_RAYS * _HOT.itemsize)
_FLAGS_AT = _COLD_AT + np.uint64(BLOCK_RAYS * _COLD.itemsize)
_HITS_AT = _FLAGS_AT + np.uint64(_GROUPS + 64)
_LISTS_AT = _HITS_AT + np.uint64(4 * BLOCK_RAYS + 64)
_MEMORY_BYTES = int(_LISTS_AT) + 4 * (MAX_DEPTH + 1) * 9 * (BLOCK_RAYS + 16) + 64


def _packed(kx: int, ky: int, kz: int) -> np.int32:
    """The four bytes of `_HOT`'s axes and what follows them."""
    return np.int32(kx | ky << 8 | kz << 16)


_AXES_X = _packed(1, 2, 0)
_AXES_Y = _packed(2, 0, 1)
_AXES_Z = _packed(0, 1, 2)


@device
def _in_frame(is_y, is_z, x, y, z):
    """Vectors along the world's axes in the order of the frames."""
    return (
        select(is_z, x, select(is_y, z, y)),
        select(is_z, y, select(is_y, x, z)),
        select(is_z, z, select(is_y, y, x)),
    )


@device
def _kinds(group):
    kinds = group.direction_class & np.int32(3)
    return kinds == np.int32(1), kinds == np.int32(2)


@device
def _arrange(group, memory, number):
    """Put a loaded group's numbers into the order of this kernel, and write its rays' records.

    `near` and `far` become the slab constants of the low and the high planes; origin and direction
    are put in the order of the frames.
    """
    is_y, is_z = _kinds(group)
    inv, near, far = group.inv, group.near, group.far
    for axis in range(_U3):
        back = inv[axis] < _ZERO
        low, high = select(back, far[axis], near[axis]), select(back, near[axis], far[axis])
        near[axis], far[axis] = low, high
    origin, direction, shear = group.origin, group.direction, group.shear
    ox, oy, oz = _in_frame(is_y, is_z, *three(origin))
    dx, dy, dz = _in_frame(is_y, is_z, *three(direction))
    origin[_X], origin[_Y], origin[_Z] = ox, oy, oz
    direction[_X], direction[_Y], direction[_Z] = dx, dy, dz
    axes = select(is_z, i32x16(_AXES_Z), select(is_y, i32x16(_AXES_Y), i32x16(_AXES_X)))
    slabs = three(inv) + three(near) + three(far)
    rest = group.t_min, group.t, ox, oy, oz, bits_as_float(axes), shear[_X]
    store_records(memory + _HOT_AT + number * _HOT_BYTES, slabs + rest)
    store_records(memory + _COLD_AT + number * _COLD_BYTES, (dx, dy, dz, shear[_Y]))


@device
def _load_block(memory, source, first, last, groups):
    """Load packets first to last; list the groups with a ray that can hit anything.

    Returns
    -------
    count, ray_count : uint64
        Groups in the list, and their rays.
    """
    g, count, ray_count = _U0, _U0, _U0
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(source.order, packet, row)
            if length == _U0:
                continue
            group = Group(memory, g)
            is_slow = load_group(group, ray, length, source.rays, source.frame, source.status)
            _arrange(group, memory, g << _LANE_SHIFT)
            store(memory + _FLAGS_AT + g, np.uint8(is_slow))
            bits = mask_bits(group.t_min <= group.t)
            store(groups + count * LANE, np.uint32((g << _HALF) | bits))
            count += np.uint64(bits != _U0)
            ray_count += popcount(bits)
            g += _U1
    return count, ray_count


@device
def _store_block(memory, order, first, last, wants_any, out):
    """Write the results of packets first to last."""
    g = _U0
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(order, packet, row)
            if length == _U0:
                continue
            is_slow = load(np.uint8, memory + _FLAGS_AT + g) != np.uint8(0)
            store_group(memory + g * _GROUP_BYTES, ray, length, is_slow, wants_any, out)
            g += _U1


@device
def _interval(low_x, low_y, low_z, high_x, high_y, high_z, inv, low, high):
    """Padded slab interval of boxes, for any direction.

    The same numbers as those of `slab_interval` with the planes chosen: rounding keeps the order of
    the two distances of an axis.
    """
    x_1, x_2 = fma(low_x, inv[0], low[0]), fma(high_x, inv[0], high[0])
    y_1, y_2 = fma(low_y, inv[1], low[1]), fma(high_y, inv[1], high[1])
    z_1, z_2 = fma(low_z, inv[2], low[2]), fma(high_z, inv[2], high[2])
    t_in = maximum(maximum(minimum(x_1, x_2), minimum(y_1, y_2)), minimum(z_1, z_2))
    t_out = minimum(minimum(maximum(x_1, x_2), maximum(y_1, y_2)), maximum(z_1, z_2))
    return t_in, t_out


@device
def _push(stack, top, node, small, lanes, room, hit_count, tree):
    """Push the children of a node that have a list, the farthest first; returns the height."""
    t_in = small.t_in
    entered = t_in < _INF
    key = (float_as_bits(maximum(t_in, _ZERO)) & _KEY_BITS) | lane_numbers(i32x8)
    small.keys = sort_keys(select(entered, key, i32x8(_LEAST_KEY)))
    children = node.children
    for k in range(popcount(mask_bits(entered))):
        lane = np.uint64(lanes.keys[k] & KEY_LANES)
        prefetch_child(children[lane], tree.nodes, tree.leaves)
        entry = _Entry(stack, top)
        entry.child, entry.count, entry.list = (
            children[lane],
            np.uint32(lanes.count[lane]),
            lanes.list[lane],
        )
        entry.room, entry.t_in = room, lanes.t_in[lane]
        entry.hit_count, entry.ray_count = np.uint32(hit_count), lanes.ray_count[lane]
        top += _U1
    return top


@device
def _visit_with_groups(node, groups, count, memory, small, lanes, room):
    """Test a node's boxes against the groups of a list; make the children's lists.

    Returns the end of the lists.
    """
    small.t_in = f32x8(_INF)
    planes, children = node.planes, node.children
    for lane in range(_WIDTH):
        if children[lane] == np.int32(0):
            break
        low_x, high_x = f32x16(planes[_U0, lane]), f32x16(planes[_U1, lane])
        low_y, high_y = f32x16(planes[_U2, lane]), f32x16(planes[_U3, lane])
        low_z, high_z = f32x16(planes[np.uint64(4), lane]), f32x16(planes[np.uint64(5), lane])
        least = f32x16(_INF)
        written, ray_count = _U0, _U0
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> _HALF
            group = Group(memory, g)
            t_in, t_out = _interval(
                low_x,
                low_y,
                low_z,
                high_x,
                high_y,
                high_z,
                three(group.inv),
                three(group.near),
                three(group.far),
            )
            entered = maximum(t_in, group.t_min) <= minimum(t_out, group.t)
            least = select(entered, minimum(t_in, least), least)
            bits = mask_bits(entered)
            store(room + written * LANE, np.uint32((g << _HALF) | bits))
            written += np.uint64(bits != _U0)
            ray_count += popcount(bits)
        lanes.list[lane], lanes.count[lane], lanes.ray_count[lane] = room, written, ray_count
        lanes.t_in[lane] = reduce_min(least)
        room += written * LANE
    return room


@device
def _visit_with_rays(node, rays, count, memory, small, lanes, hits, room):
    """The same with a list of rays."""
    planes = node.planes
    low_x, high_x = planes[_U0], planes[_U1]
    low_y, high_y = planes[_U2], planes[_U3]
    low_z, high_z = planes[np.uint64(4)], planes[np.uint64(5)]
    is_used = node.children != np.int32(0)
    least = f32x8(_INF)
    for j in range(count):
        ray = _Hot(memory + _HOT_AT, np.uint64(load(np.uint32, rays + j * LANE)))
        t_in, t_out = _interval(
            low_x, low_y, low_z, high_x, high_y, high_z, ray.inv, ray.low, ray.high
        )
        entered = is_used & (maximum(t_in, ray.t_min) <= minimum(t_out, ray.t))
        least = select(entered, minimum(t_in, least), least)
        store(hits + j * LANE, np.uint32(mask_bits(entered)))
    # Bits behind the list must be 0: 16 are read at a time.
    store(hits + count * LANE, i32x16(np.int32(0)))
    small.t_in = least
    zero = i32x16(np.int32(0))
    found = mask_bits(least < _INF)
    while found != _U0:
        lane = count_trailing_zeros(found)
        found &= found - _U1
        bit = i32x16(np.int32(_U1 << lane))
        written = _U0
        for j in range(_U0, count, _LANES):
            at = j * LANE
            enters = (load(i32x16, hits + at) & bit) != zero
            store(room + written * LANE, compress(enters, load(i32x16, rays + at)))
            written += popcount(mask_bits(enters))
        lanes.list[lane], lanes.count[lane], lanes.ray_count[lane] = room, written, _U0
        room += written * LANE
    return room


@device
def _expand(groups, count, memory, t_in, rays):
    """List the rays of a list of groups without a hit before t_in; returns their number."""
    kept = _U0
    for j in range(count):
        packed = np.uint64(load(np.uint32, groups + j * LANE))
        g = packed >> _HALF
        inside = lanes_from_bits(mask16, packed & _LOW) & (Group(memory, g).t >= t_in)
        numbers = lane_numbers(i32x16) + np.int32(g << _LANE_SHIFT)
        store(rays + kept * LANE, compress(inside, numbers))
        kept += popcount(mask_bits(inside))
    return kept


@device
def _still_wanted(rays, count, memory, t_in):
    """Remove the rays of a list with a hit before `t_in`; returns its new length."""
    kept = _U0
    for j in range(count):
        ray = load(np.uint32, rays + j * LANE)
        store(rays + kept * LANE, ray)
        kept += np.uint64(_Hot(memory + _HOT_AT, np.uint64(ray)).t >= t_in)
    return kept


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
def _extent_of(corners, axis, lane):
    a, b, c = corners[_FIRST, axis, lane], corners[_SECOND, axis, lane], corners[_THIRD, axis, lane]
    return f32x16(min(min(a, b), c)), f32x16(max(max(a, b), c))


@device
def _extent(block, axis):
    """Low and high coordinates of four triangles along an axis."""
    corners = block.corners
    a, b, c = corners[_FIRST, axis], corners[_SECOND, axis], corners[_THIRD, axis]
    return minimum(minimum(a, b), c), maximum(maximum(a, b), c)


@device
def _write_normals(block, small):
    corners, normal = block.corners, small.normal
    normal[_X], normal[_Y], normal[_Z] = plane_normal(
        (corners[_FIRST, _X], corners[_FIRST, _Y], corners[_FIRST, _Z]),
        (corners[_SECOND, _X], corners[_SECOND, _Y], corners[_SECOND, _Z]),
        (corners[_THIRD, _X], corners[_THIRD, _Y], corners[_THIRD, _Z]),
    )


@device
def _test_with_group(g, memory, block, lane, lanes, wants_any):
    """Test a triangle against a group; returns whether a ray has a nearer hit."""
    group = Group(memory, g)
    is_y, is_z = _kinds(group)
    corners = block.corners
    a = _corner_in_frame(is_y, is_z, corners, _FIRST, lane)
    b = _corner_in_frame(is_y, is_z, corners, _SECOND, lane)
    c = _corner_in_frame(is_y, is_z, corners, _THIRD, lane)
    origin, shear = three(group.origin), group.shear
    sheared = shear_vertices(a, b, c, origin, (shear[_X], shear[_Y]))
    candidates = signs_agree(sheared)
    if not any_lane(candidates):
        return False
    low_x, high_x = _extent_of(corners, _X, lane)
    low_y, high_y = _extent_of(corners, _Y, lane)
    low_z, high_z = _extent_of(corners, _Z, lane)
    t_in, t_out = _interval(
        low_x,
        low_y,
        low_z,
        high_x,
        high_y,
        high_z,
        three(group.inv),
        three(group.near),
        three(group.far),
    )
    nearest, t_min = group.t, group.t_min
    candidates = candidates & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
    if not any_lane(candidates):
        return False
    normal = lanes.normal
    n = _in_frame(
        is_y,
        is_z,
        f64x16(normal[_X, lane]),
        f64x16(normal[_Y, lane]),
        f64x16(normal[_Z, lane]),
    )
    # The distance first: rays that leave a surface meet its triangle behind their origin.
    t = minimum(maximum(distance_along(a, n, origin, three(group.direction)), t_in), t_out) + _ZERO
    candidates = candidates & (t >= t_min) & (t <= nearest)
    if not any_lane(candidates):
        return False
    hit, u, v = barycentrics(sheared, False)
    prim_id, best = i32x16(block.prim_ids[lane]), group.prim_id
    taken = candidates & hit & ((t < nearest) | (prim_id < best))
    bits = mask_bits(taken)
    if bits == _U0:
        return False
    group.prim_id = select(taken, prim_id, best)
    if wants_any:
        t = f32x16(-_INF)
    group.t = select(taken, t, nearest)
    group.u, group.v = select(taken, u, group.u), select(taken, v, group.v)
    at = GroupLanes(memory, g)
    while bits != _U0:
        k = count_trailing_zeros(bits)
        bits &= bits - _U1
        _Hot(memory + _HOT_AT, (g << _LANE_SHIFT) | k).t = at.t[k]
    return True


@device
def _leaf_with_groups(block, groups, count, memory, small, lanes, wants_any):
    """Test a block's triangles against the groups of a list; returns the number of hits."""
    _write_normals(Block(address_of(block)), small)
    hit_count = _U0
    for lane in range(_BLOCK_LANES):
        if block.prim_ids[lane] < np.int32(0):
            break
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> _HALF
            hit_count += np.uint64(_test_with_group(g, memory, block, lane, lanes, wants_any))
    return hit_count


@device
def _vertices(hot, block):
    """The vertices of a block's four triangles, in the order of a ray's axes."""
    kx, ky, kz = hot.axes
    x, y, z = np.uint64(kx), np.uint64(ky), np.uint64(kz)
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
def _distances(hot, cold, block, small):
    """Distances of a ray to the planes of four triangles."""
    kx, ky, kz = hot.axes
    x, y, z = np.uint64(kx), np.uint64(ky), np.uint64(kz)
    corners, normal = block.corners, small.normal
    a = corners[_FIRST, x], corners[_FIRST, y], corners[_FIRST, z]
    n = normal[x], normal[y], normal[z]
    return distance_along(a, n, hot.origin, cold.direction)


@device
def _leaf_with_rays(block, rays, count, memory, small, hits, wants_any):
    """Test a block's triangles against the rays of a list; returns the number of hits."""
    # Step 1: compact the rays whose edge functions agree in sign, without branches. (With one per
    # ray, mispredictions would take half the time of a leaf.)
    hots, colds = memory + _HOT_AT, memory + _COLD_AT
    candidate_count = _U0
    for j in range(count):
        number = load(np.uint32, rays + j * LANE)
        hot, cold = _Hot(hots, np.uint64(number)), _Cold(colds, np.uint64(number))
        store(hits + candidate_count * LANE, number)
        candidate_count += np.uint64(any_lane(signs_agree(_sheared(hot, cold, block))))
    if candidate_count == _U0:
        return _U0

    # Step 2: test these exactly.
    hit_count = _U0
    low_x, high_x = _extent(block, _X)
    low_y, high_y = _extent(block, _Y)
    low_z, high_z = _extent(block, _Z)
    _write_normals(block, small)
    found = small.hits
    for j in range(candidate_count):
        number = np.uint64(load(np.uint32, hits + j * LANE))
        hot, cold = _Hot(hots, number), _Cold(colds, number)
        t_in, t_out = _interval(
            low_x, low_y, low_z, high_x, high_y, high_z, hot.inv, hot.low, hot.high
        )
        nearest, t_min = hot.t, hot.t_min
        sheared = _sheared(hot, cold, block)
        candidates = signs_agree(sheared) & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
        # The distance first: rays that leave a surface meet its triangle behind their origin.
        t = minimum(maximum(_distances(hot, cold, block, small), t_in), t_out) + _ZERO
        candidates = candidates & (t >= t_min) & (t <= nearest)
        if not any_lane(candidates):
            continue
        hit, u, v = barycentrics(sheared, False)
        bits = mask_bits(candidates & hit)
        if bits != _U0:
            hit_count += _U1
            group, k = GroupLanes(memory, number >> _LANE_SHIFT), number & _LAST_LANE
            if wants_any:
                group.prim_id[k], group.t[k], hot.t = np.int32(0), -_INF, -_INF
            else:
                found.t, found.u, found.v = t, u, v
                _keep_nearest(hot, group, k, block, bits, HitLanes(address_of(found)))
    return hit_count


@device
def _keep_nearest(hot, group, k, block, bits, found):
    """Keep the nearest of the ray's hit and the hits of some lanes, by t, then prim_id."""
    nearest, best = hot.t, group.prim_id[k]
    while bits != _U0:
        lane = count_trailing_zeros(bits)
        bits &= bits - _U1
        t, prim_id = found.t[lane], block.prim_ids[lane]
        if t < nearest or (t == nearest and prim_id < best):
            nearest, best = t, prim_id
            group.u[k], group.v[k] = found.u[lane], found.v[lane]
    hot.t, group.t[k], group.prim_id[k] = nearest, nearest, best


@device
def _trace_block(memory, groups, count, ray_count, tree, stack, small, wants_any):
    """Trace the groups of a list."""
    lanes = _SmallLanes(address_of(small))
    hits = memory + _HITS_AT
    hit_count = _U0
    root = _Entry(stack)
    root.child, root.count, root.list = np.int32(0), np.uint32(count), groups
    root.room, root.t_in = groups + (count + _LANES) * LANE, -_INF
    root.hit_count, root.ray_count = np.uint32(0), ray_count
    top = np.uint64(count != _U0)
    while top != _U0:
        top -= _U1
        entry = _Entry(stack, top)
        child, at, length, room = entry.child, entry.list, np.uint64(entry.count), entry.room
        is_grouped = entry.ray_count >= length * _FEW
        if not is_grouped:
            if entry.ray_count != _U0:
                length = _expand(at, length, memory, entry.t_in, room)
                at = room
                room += length * LANE
            elif entry.hit_count != np.uint32(hit_count):
                length = _still_wanted(at, length, memory, entry.t_in)
            if length == _U0:
                continue
        if child < np.int32(0):
            block = leaf_address(tree.leaves, child)
            end = leaf_end(block, child)
            while block != end:
                if is_grouped:
                    hit_count += _leaf_with_groups(
                        BlockLanes(block), at, length, memory, small, lanes, wants_any
                    )
                else:
                    hit_count += _leaf_with_rays(
                        Block(block), at, length, memory, small, hits, wants_any
                    )
                block += BLOCK
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
        top = _push(stack, top, NodeLanes(tree.nodes, number), small, lanes, room, hit_count, tree)


@kernel
def trace_groups(begin, end, tree, source, wants_any, out):
    """Trace packets begin to end.

    Parameters
    ----------
    begin, end : int
    tree : TreeAddresses
        Not empty.
    source : PacketSource
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    out : ResultAddresses
    """
    array = np.empty(_MEMORY_BYTES + 64, np.uint8)
    memory = (address(array) + np.uint64(63)) & ~np.uint64(63)
    stack = scratch(_STACK_BYTES)
    small = _Small(scratch(_SMALL_BYTES))
    groups = memory + _LISTS_AT
    for first in range(np.uint64(begin), np.uint64(end), _PACKETS):
        last = min(first + _PACKETS, np.uint64(end))
        count, ray_count = _load_block(memory, source, first, last, groups)
        _trace_block(memory, groups, count, ray_count, tree, stack, small, wants_any)
        _store_block(memory, source.order, first, last, wants_any, out)
    # The memory must outlive its addresses.
    array[0] = np.uint8(0)
