"""Many single rays in flight: the kernel for incoherent rays.

An incoherent ray waits for memory at every node. Here each thread keeps some rays in flight and
advances each by one node or leaf in turn: the next node is prefetched as soon as it is known, and
has arrived at the ray's next turn. Rays wait in queues by what they need next, so no branch depends
on a single ray.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import INVALID
from raystream.jit.constants import BYTES_64, INF_F32, ONE_U64, SHIFT_64, ZERO_F32, ZERO_U64
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
_NO_HITS = np.uint32(0)

#: prim_id of a ray without a hit: the greatest number.
NO_PRIM = np.int32(2**31 - 1)

#: Of an empty slot.
NO_RAY = np.int64(-1)

#: At the bottom of each stack: the smallest key, and a row that no node has.
_BOTTOM_KEY = np.int32(-(2**31))
_BOTTOM = np.int32(2**31 - 1)

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
        ("count", "u4"),  # hits, if all are wanted
        ("unused", "V8"),
    ]
)

#: Bytes of a ray's stack: keys, and behind them children, each with room for the eight lanes that
#: are always stored.
CHILDREN = np.uint64(4 * (STACK_SIZE + 16))
STACK = CHILDREN + CHILDREN

#: Bytes of a queue of slots, with room for the one that is always stored.
QUEUE_BYTES = int(IN_FLIGHT * BYTES_64 + _LINE)

_STACKS_BYTES = int(IN_FLIGHT * STACK)
_HITS_BYTES = HITS.itemsize


@device
def start_ray(slot, stack, i, ray, max_coordinate):
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
    slot.prim_id, slot.u, slot.v, slot.count = NO_PRIM, ZERO_F32, ZERO_F32, _NO_HITS
    slot.child, slot.top = np.int32(0), LANE
    slot.ray, slot.t_scale, slot.t_offset = np.int64(i), ray.t_scale, ray.t_offset
    store(stack, _BOTTOM_KEY)
    store(stack + CHILDREN, _BOTTOM)


@device
def finish_ray(slot, wanted):
    """Write the nearest or any hit of a slot's ray, if it has one, and empty the slot."""
    if slot.ray < np.int64(0):
        return
    (i, prim_id), out = (np.uint64(slot.ray), slot.prim_id), wanted.out
    slot.ray = NO_RAY
    if wanted.wants_any:
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
def visit_node(slot, nodes, stack):
    """Test a node's eight boxes and push those that are entered; returns the stack's height."""
    node = Node(nodes, np.uint64(slot.child))
    x, y, z = slot.planes
    planes = node.planes
    near = planes[x], planes[y], planes[z]
    box = (*near, planes[x ^ ONE_U64], planes[y ^ ONE_U64], planes[z ^ ONE_U64])
    t_in, t_out = slab_interval(box, slot.inv, slot.near, slot.far)
    entered = maximum(t_in, slot.t_min) <= minimum(t_out, slot.t)
    # Keys: entry distance with the lane in the lowest bits, at least 0 since only the bits of
    # positive numbers are in the numbers' order. Boxes that are missed sink to the end.
    key = (float_as_bits(maximum(t_in, ZERO_F32)) & _KEY_BITS) | lane_numbers(i32x8)
    key = sort_keys(select(entered, key, i32x8(_BOTTOM_KEY)))
    top = slot.top
    store(stack + top, key)
    store(stack + CHILDREN + top, permute(node.children, key))
    return top + (popcount(mask_bits(entered)) << np.uint64(2))


@device
def filter_of(filter_, slot):
    """The `RayFilter` of a slot's ray; None without a filter."""
    if filter_ is None:
        return None
    return RayFilter(filter_, np.uint64(slot.ray), slot.t_scale, slot.t_offset)


@device
def line_of(slot):
    """The `BlockRay` of a slot."""
    return BlockRay(
        slot.axes, slot.inv, slot.near, slot.far, slot.origin, slot.direction, slot.shear
    )


@device
def test_leaf(slot, leaves, lanes_at, keep, given):
    """Test the triangles of a slot's next leaf; returns whether its ray is done.

    ``keep(slot, block, bits, lanes, given)`` takes the ray's hits with some triangles of the block
    at an address, and returns the same.
    """
    at = leaf_address(leaves, slot.child)
    end = leaf_end(at, slot.child)
    while at != end:
        bits = test_block(at, line_of(slot), slot.t_min, slot.t, False, lanes_at)
        if bits != ZERO_U64 and keep(slot, at, bits, HitLanes(lanes_at), given):
            return True
        at += BLOCK
    return False


@device
def _visit_leaf(slot, tree, frame, source, lanes_at, wanted):
    return test_leaf(slot, tree.leaves, lanes_at, _keep, wanted)


@device
def _keep(slot, at, bits, lanes, wanted):
    own, block = filter_of(wanted.filter, slot), Block(at)
    if not wanted.wants_any:
        _keep_nearest(slot, block, bits, lanes, own)
    elif any_kept(own, block, bits, lanes):
        slot.prim_id = np.int32(0)
        return True
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
def _prefetch(slot, stack, tree):
    """Prefetch a slot's next node or leaf."""
    prefetch_child(slot.child, tree.nodes, tree.leaves)


@device
def next_child(slot, top, stack, tree, prefetching, prefetch=_prefetch):
    """Pop the nearest child within the search interval.

    Returns
    -------
    is_node, is_leaf, is_end : uint64
        1 for what it is, and 0: a node, a leaf, or the bottom of the stack.
    """
    limit = slot.t_key
    top -= LANE
    while load(np.int32, stack + top) > limit:
        top -= LANE
    child = load(np.int32, stack + CHILDREN + top)
    slot.child, slot.top = child, top
    if prefetching:
        prefetch(slot, stack, tree)
    is_leaf, is_end = np.uint64(child < np.int32(0)), np.uint64(child == _BOTTOM)
    return (is_leaf | is_end) ^ ONE_U64, is_leaf, is_end


@device
def item(queue, j):
    """The slot at a place of a queue."""
    return load(np.uint64, queue + (j << SHIFT_64))


@device
def append(queue, count, k, is_next):
    """Append slot k to a queue if `is_next` is 1, without a branch; returns the queue's length."""
    store(queue + (count << SHIFT_64), k)
    return count + is_next


@device
def _complete(slot, tree, frame, source, wanted):
    """The `complete` of a scene with one tree."""


@device
def _begin(slot, stack, i, ray, tree, frame, source):
    """The `begin` of a tree whose rays need no more than a `SLOT`."""


@device
def _visit_node(slot, stack, tree):
    return visit_node(slot, tree.nodes, stack)


class TreeKind(NamedTuple):
    """How rays in flight walk a kind of tree.

    Attributes
    ----------
    record : dtype
        Of a slot: `SLOT`, and what else the functions write and read.
    begin : device function
        ``begin(slot, stack, i, ray, tree, frame, source)`` does what is left to do for ray i, a
        `LocalRay`, after `start_ray`.
    visit_node, prefetch : device function
        Of the next node: ``visit_node(slot, stack, tree)``, see `visit_node`, and
        ``prefetch(slot, stack, tree)``, also of the next leaf, or of none.
    """

    record: np.dtype[Any]
    begin: Any
    visit_node: Any
    prefetch: Any


#: The wide tree.
WIDE = TreeKind(SLOT, _begin, _visit_node, _prefetch)


def wavefront_kernel(visit_leaf, finish, complete=_complete, kind=WIDE):
    """Make the kernel for rays in flight.

    Parameters
    ----------
    visit_leaf : device function
        ``visit_leaf(slot, tree, frame, source, lanes, wanted)`` tests the primitives of the slot's
        next leaf and keeps their hits; returns whether its ray is done. `lanes` is the address of
        `HITS`.
    finish : device function
        ``finish(slot, wanted)`` writes the result of a slot's ray, if it has one, and empties the
        slot.
    complete : device function
        ``complete(slot, tree, frame, source, wanted)`` searches for the ray of a slot, if it has
        one, what else is in the scene [default: nothing].
    kind : TreeKind, optional

    Returns
    -------
    kernel
        ``trace_wavefront(begin, end, tree, frame, source, prefetching, wanted)`` traces rays begin
        to end.

        tree : NamedTuple
            With addresses of ``nodes``, not empty, and ``leaves``, or what else `kind` takes.
        frame : SceneFrame
        source : RaySource
        prefetching : bool
            Prefetch nodes: pays off if the tree does not fit into the cache.
        wanted : NamedTuple
            As the functions take it, with ``out``, a `ResultAddresses`.
    """
    slot_view, slots_bytes = view(kind.record), int(IN_FLIGHT) * kind.record.itemsize
    begin_ray, visit, prefetch = kind.begin, kind.visit_node, kind.prefetch

    @kernel
    def trace_wavefront(begin, end, tree, frame, source, prefetching, wanted):
        slots, stacks = scratch(slots_bytes), scratch(_STACKS_BYTES)
        lanes = scratch(_HITS_BYTES)
        # Slots by what their rays need next: a node, a leaf, or nothing more.
        node, leaf, done = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
        node_count, leaf_count, done_count = ZERO_U64, ZERO_U64, ZERO_U64
        ray_next, ray_end = np.uint64(begin), np.uint64(end)
        for k in range(IN_FLIGHT):
            done_count = append(done, done_count, k, ONE_U64)
            slot_view(slots, k).ray = NO_RAY

        while True:
            # Step 1: write the results of finished slots and start new rays in them.
            for j in range(done_count):
                k = item(done, j)
                slot = slot_view(slots, k)
                complete(slot, tree, frame, source, wanted)
                finish(slot, wanted)
                if ray_next < ray_end:
                    ray = load_ray(source, ray_next, frame)
                    if ray.status == INVALID:
                        store(wanted.out.status + ray_next, INVALID)
                    stack = stacks + k * STACK
                    start_ray(slot, stack, ray_next, ray, frame.max_coordinate)
                    begin_ray(slot, stack, ray_next, ray, tree, frame, source)
                    ray_next += ONE_U64
                    node_count = append(node, node_count, k, ONE_U64)
            done_count = ZERO_U64
            if node_count | leaf_count == ZERO_U64:
                break

            # Step 2: visit a node for each ray that waits for one. A queue is written where it has
            # been read already.
            waiting, node_count = node_count, ZERO_U64
            for j in range(waiting):
                k = item(node, j)
                slot, stack = slot_view(slots, k), stacks + k * STACK
                top = visit(slot, stack, tree)
                is_node, is_leaf, is_end = next_child(slot, top, stack, tree, prefetching, prefetch)
                node_count = append(node, node_count, k, is_node)
                leaf_count = append(leaf, leaf_count, k, is_leaf)
                done_count = append(done, done_count, k, is_end)

            # Step 3: test a leaf for each ray that waits for one.
            waiting, leaf_count = leaf_count, ZERO_U64
            for j in range(waiting):
                k = item(leaf, j)
                slot, stack = slot_view(slots, k), stacks + k * STACK
                is_done = visit_leaf(slot, tree, frame, source, lanes, wanted)
                top = LANE if is_done else slot.top
                is_node, is_leaf, is_end = next_child(slot, top, stack, tree, prefetching, prefetch)
                node_count = append(node, node_count, k, is_node)
                leaf_count = append(leaf, leaf_count, k, is_leaf)
                done_count = append(done, done_count, k, is_end)

    return trace_wavefront


#: The nearest or any hits in a tree of triangles, `TreeAddresses`, for a `NearestWanted`.
trace_wavefront = wavefront_kernel(_visit_leaf, finish_ray)
