"""Many single rays in flight: the kernel for incoherent rays.

An incoherent ray waits for memory at every node. Here each thread keeps some rays in flight and
advances each by one node or leaf in turn: the next node is prefetched as soon as it is known, and
has arrived at the ray's next turn. Rays wait in queues by what they need next, so no branch depends
on a single ray.
"""

from __future__ import annotations

import numpy as np

from raystream.core.rays import INVALID
from raystream.jit.constants import BYTES_64, INF_F32, ONE_U64, ZERO_F32
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    count_trailing_zeros,
    float_as_bits,
    i32x8,
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
)
from raystream.jit.views import view
from raystream.kernels.hit_filter import RayFilter, any_kept, keeps
from raystream.kernels.leaf_block import AXIS, BLOCK, HITS, Block, BlockRay, HitLanes, test_block
from raystream.kernels.ray import component, prepare_ray, world_t
from raystream.kernels.ray_source import load_ray
from raystream.kernels.triangle_lanes import slab_interval
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.node_layout import (
    LANE,
    Node,
    leaf_address,
    leaf_end,
    plane_row,
    prefetch_child,
    sort_keys,
    t_key,
)

#: Rays in flight per thread. 16 hide less memory latency, 64 need too much cache.
IN_FLIGHT = np.uint64(32)

_LINE = np.uint64(64)
_MISS = np.int32(-1)
_KEY_BITS = np.int32(~7)

#: prim_id of a ray without a hit: the greatest number.
NO_PRIM = np.int32(2**31 - 1)

#: Of an empty slot.
NO_RAY = np.int64(-1)

#: At the bottom of each stack: the smallest key, and a row that no node has.
_BOTTOM_KEY = np.int32(-(2**31))
BOTTOM = np.int32(2**31 - 1)

#: A ray in flight. Axes are in the order of the ray's frame: kx, ky, kz.
SLOT = np.dtype(
    [
        ("inv", "f4", 3),
        ("near", "f4", 3),
        ("far", "f4", 3),
        ("origin", "f4", 3),
        ("shear", "f4", 3),
        ("t_min", "f4"),
        ("t", "f4"),
        ("prim_id", "i4"),
        ("u", "f4"),
        ("v", "f4"),
        ("t_key", "i4"),  # children with a larger key are beyond the nearest hit
        ("child", "i4"),  # next node or leaf
        ("top", "u8"),  # bytes on the stack
        ("ray", "i8"),
        ("t_scale", "f8"),
        ("t_offset", "f8"),
        ("planes", "u8", 3),  # rows of a node's planes that the ray enters by
        ("axes", "u8", 3),  # see `BlockRay`
        ("direction", "f4", 3),
        ("unused", "V12"),
    ]
)
Slot = view(SLOT)
_SLOT_BYTES = np.uint64(SLOT.itemsize)

#: Bytes of a ray's stacks, with room for the eight lanes that are always stored.
STACK = np.uint64(4 * (STACK_SIZE + 16))

_SLOTS_BYTES = int(IN_FLIGHT * _SLOT_BYTES)
_STACK_BYTES = int(IN_FLIGHT * STACK)
_HITS_BYTES = HITS.itemsize
QUEUE_BYTES = int(IN_FLIGHT * BYTES_64 + _LINE)


@device
def start_ray(slot, keys, children, i, ray, max_coordinate):
    """Put a ray into a slot, before the root."""
    r = prepare_ray(ray.origin, ray.direction, max_coordinate)
    inv_x = component(r.kx, r.inv_x, r.inv_y, r.inv_z)
    inv_y = component(r.ky, r.inv_x, r.inv_y, r.inv_z)
    inv_z = r.sz
    slot.inv = inv_x, inv_y, inv_z
    slot.near = (
        component(r.kx, r.near_x, r.near_y, r.near_z),
        component(r.ky, r.near_x, r.near_y, r.near_z),
        component(r.kz, r.near_x, r.near_y, r.near_z),
    )
    slot.far = (
        component(r.kx, r.far_x, r.far_y, r.far_z),
        component(r.ky, r.far_x, r.far_y, r.far_z),
        component(r.kz, r.far_x, r.far_y, r.far_z),
    )
    slot.origin = r.ox, r.oy, r.oz
    slot.direction = r.dx, r.dy, r.dz
    slot.shear = r.sx, r.sy, r.sz
    slot.planes = plane_row(r.kx, inv_x), plane_row(r.ky, inv_y), plane_row(r.kz, inv_z)
    slot.axes = r.kx * AXIS, r.ky * AXIS, r.kz * AXIS
    slot.t_min, slot.t, slot.t_key = ray.t_min, ray.t_max, t_key(ray.t_max)
    slot.prim_id, slot.u, slot.v = NO_PRIM, ZERO_F32, ZERO_F32
    slot.child, slot.top = np.int32(0), LANE
    slot.ray, slot.t_scale, slot.t_offset = np.int64(i), ray.t_scale, ray.t_offset
    store(keys, _BOTTOM_KEY)
    store(children, BOTTOM)


@device
def finish_ray(slot, wants_any, out):
    """Write the result of a slot's ray, if it has one."""
    if slot.ray < np.int64(0):
        return
    i, prim_id = np.uint64(slot.ray), slot.prim_id
    if wants_any:
        store(out.seen + i, np.uint8(prim_id != NO_PRIM))
        return
    t = INF_F32
    if prim_id == NO_PRIM:
        prim_id = _MISS
    else:
        t = world_t(slot.t, slot.t_scale, slot.t_offset)
    at = i * LANE
    store(out.t + at, t)
    store(out.u + at, slot.u)
    store(out.v + at, slot.v)
    store(out.prim_id + at, prim_id)


@device
def visit_node(slot, node, keys, children, numbers):
    """Test a node's eight boxes and push those that are entered; returns the stack's height."""
    x, y, z = slot.planes
    planes = node.planes
    t_in, t_out = slab_interval(
        planes[x],
        planes[y],
        planes[z],
        planes[x ^ ONE_U64],
        planes[y ^ ONE_U64],
        planes[z ^ ONE_U64],
        slot.inv,
        slot.near,
        slot.far,
    )
    entered = maximum(t_in, slot.t_min) <= minimum(t_out, slot.t)
    # Keys: entry distance with the lane in the lowest bits, at least 0 since only the bits of
    # positive numbers are in the numbers' order. Boxes that are missed sink to the end.
    key = (float_as_bits(maximum(t_in, ZERO_F32)) & _KEY_BITS) | numbers
    key = sort_keys(select(entered, key, i32x8(_BOTTOM_KEY)))
    top = slot.top
    store(keys + top, key)
    store(children + top, permute(node.children, key))
    return top + (popcount(mask_bits(entered)) << np.uint64(2))


@device
def filter_of(filter_, slot):
    """The `RayFilter` of a slot's ray; None without a filter."""
    if filter_ is None:
        return None
    return RayFilter(filter_, np.uint64(slot.ray), slot.t_scale, slot.t_offset)


@device
def slot_ray(slot):
    """The `BlockRay` of a slot's ray."""
    return BlockRay(
        slot.axes, slot.inv, slot.near, slot.far, slot.origin, slot.direction, slot.shear
    )


@device
def _visit_leaf(slot, tree, frame, source, lanes_at, wants_any, filter_):
    """Test the triangles of the next leaf; returns whether the ray is done."""
    child = slot.child
    at = leaf_address(tree.leaves, child)
    end = leaf_end(at, child)
    while at != end:
        bits = test_block(at, slot_ray(slot), slot.t_min, slot.t, False, lanes_at)
        if bits != np.uint64(0):
            block, lanes, of_ray = Block(at), HitLanes(lanes_at), filter_of(filter_, slot)
            if not wants_any:
                _keep_nearest(slot, block, bits, lanes, of_ray)
            elif any_kept(of_ray, block, bits, lanes):
                slot.prim_id = np.int32(0)
                return True
        at += BLOCK
    return False


@device
def _keep_nearest(slot, block, bits, lanes, filter_):
    """Keep the nearest of the slot's hit and the hits of some lanes, by t, then prim_id."""
    nearest, best = slot.t, slot.prim_id
    while bits != np.uint64(0):
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        t, prim_id = lanes.t[lane], block.prim_ids[lane]
        is_nearer = t < nearest or (t == nearest and prim_id < best)
        u, v = lanes.u[lane], lanes.v[lane]
        if is_nearer and keeps(filter_, t, u, v, prim_id):
            nearest, best = t, prim_id
            slot.u, slot.v = u, v
    slot.t, slot.prim_id, slot.t_key = nearest, best, t_key(nearest)


@device
def next_child(slot, top, keys, children, tree, prefetching):
    """Pop the nearest child within the search interval; returns its link."""
    limit = slot.t_key
    top -= LANE
    while load(np.int32, keys + top) > limit:
        top -= LANE
    child = load(np.int32, children + top)
    slot.child, slot.top = child, top
    if prefetching:
        prefetch_child(child, tree.nodes, tree.leaves)
    return child


@device
def _complete(slot, tree, frame, source, wants_any):
    """The `complete` of a scene with one tree."""


def wavefront_kernel(visit_leaf, complete=_complete):
    """Make the kernel for rays in flight.

    Parameters
    ----------
    visit_leaf : device function
        ``visit_leaf(slot, tree, frame, source, lanes, wants_any, filter_)`` tests the primitives of
        the slot's next leaf and keeps their hits in the slot; returns whether its ray is done.
        `lanes` is the address of `HITS`.
    complete : device function
        ``complete(slot, tree, frame, source, wants_any)`` searches for the ray of a slot, if it has
        one, what else is in the scene [default: nothing].

    Returns
    -------
    kernel
        ``trace_wavefront(begin, end, tree, frame, source, wants_any, prefetching, filter_, out)``
        traces rays begin to end.

        tree : NamedTuple
            With addresses of ``nodes``, not empty, and ``leaves``.
        frame : SceneFrame
        source : RaySource
        wants_any : bool
            Find whether there is a hit, else the nearest one.
        prefetching : bool
            Prefetch nodes: pays off if the tree does not fit into the cache.
        filter_ : HitFilter or None
        out : ResultAddresses
    """

    @kernel
    def trace_wavefront(begin, end, tree, frame, source, wants_any, prefetching, filter_, out):
        slots = scratch(_SLOTS_BYTES)
        all_keys = scratch(_STACK_BYTES)
        all_children = scratch(_STACK_BYTES)
        lanes = scratch(_HITS_BYTES)
        inner = scratch(QUEUE_BYTES)
        inner_next = scratch(QUEUE_BYTES)
        leaf = scratch(QUEUE_BYTES)
        leaf_next = scratch(QUEUE_BYTES)
        done = scratch(QUEUE_BYTES)
        numbers = lane_numbers(i32x8)
        ray_next, ray_end = np.uint64(begin), np.uint64(end)
        # Lengths of the queues, in bytes.
        inner_size = np.uint64(0)
        leaf_size = np.uint64(0)
        done_size = np.uint64(0)
        for k in range(IN_FLIGHT):
            store(done + done_size, k)
            done_size += BYTES_64
            Slot(slots, k).ray = NO_RAY

        while True:
            # Step 1: write the results of finished slots and start new rays in them.
            at = np.uint64(0)
            while at != done_size:
                k = load(np.uint64, done + at)
                at += BYTES_64
                slot = Slot(slots, k)
                complete(slot, tree, frame, source, wants_any)
                finish_ray(slot, wants_any, out)
                slot.ray = NO_RAY
                if ray_next < ray_end:
                    ray = load_ray(source, ray_next, frame)
                    if ray.status == INVALID:
                        store(out.status + ray_next, INVALID)
                    start_ray(
                        slot,
                        all_keys + k * STACK,
                        all_children + k * STACK,
                        ray_next,
                        ray,
                        frame.max_coordinate,
                    )
                    ray_next += ONE_U64
                    store(inner + inner_size, k)
                    inner_size += BYTES_64
            done_size = np.uint64(0)
            if inner_size == np.uint64(0) and leaf_size == np.uint64(0):
                break

            # Step 2: visit a node for each ray that waits for one.
            next_size = np.uint64(0)
            at = np.uint64(0)
            while at != inner_size:
                k = load(np.uint64, inner + at)
                at += BYTES_64
                slot = Slot(slots, k)
                keys, children = all_keys + k * STACK, all_children + k * STACK
                node = Node(tree.nodes, np.uint64(slot.child))
                top = visit_node(slot, node, keys, children, numbers)
                child = next_child(slot, top, keys, children, tree, prefetching)
                # Branchless: append the slot to all queues, and lengthen one of them.
                is_leaf = np.uint64(child < np.int32(0))
                is_done = np.uint64(child == BOTTOM)
                store(inner_next + next_size, k)
                store(leaf + leaf_size, k)
                store(done + done_size, k)
                leaf_size += is_leaf << np.uint64(3)
                done_size += is_done << np.uint64(3)
                next_size += ((is_leaf | is_done) ^ ONE_U64) << np.uint64(3)
            inner, inner_next = inner_next, inner
            inner_size = next_size

            # Step 3: test a leaf for each ray that waits for one.
            next_size = np.uint64(0)
            at = np.uint64(0)
            while at != leaf_size:
                k = load(np.uint64, leaf + at)
                at += BYTES_64
                slot = Slot(slots, k)
                keys, children = all_keys + k * STACK, all_children + k * STACK
                top = slot.top
                if visit_leaf(slot, tree, frame, source, lanes, wants_any, filter_):
                    top = LANE
                child = next_child(slot, top, keys, children, tree, prefetching)
                is_leaf = np.uint64(child < np.int32(0))
                is_done = np.uint64(child == BOTTOM)
                store(inner + inner_size, k)
                store(leaf_next + next_size, k)
                store(done + done_size, k)
                next_size += is_leaf << np.uint64(3)
                done_size += is_done << np.uint64(3)
                inner_size += ((is_leaf | is_done) ^ ONE_U64) << np.uint64(3)
            leaf, leaf_next = leaf_next, leaf
            leaf_size = next_size

    return trace_wavefront


#: Through a tree of triangles, `TreeAddresses`.
trace_wavefront = wavefront_kernel(_visit_leaf)
