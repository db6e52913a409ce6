"""Many single rays in flight through instances: the kernel for incoherent rays.

As `structures.bvh.walks.in_flight`, which hides that a ray waits for memory at every node. A ray
has two slots with a stack each: one in the tree over the instances, and one in the tree of the
object that it is in. What it needs next, in either, decides in which queue it waits.
"""

from __future__ import annotations

import numpy as np

from raystream.core.rays import INVALID
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.geometry.instances.traversal import load_scene_ray
from raystream.jit.constants import INF_F32, NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    i32x8,
    lane_numbers,
    load,
    scratch,
    store,
)
from raystream.jit.views import address_of, view
from raystream.kernels.best import Best, best_views, offer_hits
from raystream.kernels.leaf_block import BLOCK, HITS, BlockLanes, HitLanes, test_block
from raystream.kernels.ray import local_limit
from raystream.kernels.ray_source import load_ray
from raystream.structures.bvh.node_layout import (
    LANE,
    Node,
    leaf_address,
    leaf_end,
    prefetch_child,
    t_key,
)
from raystream.structures.bvh.walks.in_flight import (
    BOTTOM,
    IN_FLIGHT,
    NO_PRIM,
    NO_RAY,
    QUEUE_BYTES,
    SLOT,
    STACK,
    filter_of,
    finish_ray,
    next_child,
    slot_ray,
    start_ray,
    visit_node,
)

#: A ray in flight in one of two trees: of the instances, or of an object. The former has the hit,
#: and its t as it is reported.
_SLOT = np.dtype(
    [*SLOT.descr, ("nodes", "u8"), ("leaves", "u8"), ("best_t", "f4"), ("first_id", "i4")]
)
_Slot = view(_SLOT)

#: The same for `kernels.best`, as one ray with a lane index.
_, _Best = best_views(_SLOT, limit="t", t="best_t", t_scale="t_scale", t_offset="t_offset")

#: Slots: those of the tree over the instances come first.
_SLOTS = np.uint64(2) * IN_FLIGHT
_SLOTS_BYTES = int(_SLOTS) * _SLOT.itemsize
_STACK_BYTES = int(_SLOTS * STACK)
_HITS_BYTES = HITS.itemsize

_WORD, _WORD_SHIFT = np.uint64(8), np.uint64(3)
_LEAF_SHIFT = np.int32(3)


@device
def _start(slot, keys, children, i, source, frame, top, status):
    """Put ray i into a slot, before the root of the tree over the instances."""
    ray, most, _ = load_scene_ray(source, i, top, frame)
    if ray.status == INVALID:
        store(status + i, INVALID)
    start_ray(slot, keys, children, i, ray, most)
    slot.best_t = INF_F32


@device
def _enter(slot, inner, keys, children, source, objects):
    """Put a ray into the slot for objects, before the root of its next instance's object.

    Returns whether anything is to be searched there.
    """
    index = np.uint64(np.int32(~slot.child) >> _LEAF_SHIFT)
    instance = InstanceRecord(slot.leaves, index)
    object_ = ObjectRecord(objects, np.uint64(instance.object_id))
    i = np.uint64(slot.ray)
    ray = load_ray(source, i, object_, instance)
    far = ray.t_max
    if slot.prim_id != NO_PRIM:
        far = min(far, local_limit(slot.best_t, ray.t_scale, ray.t_offset))
    if not (ray.t_min <= far) or object_.nodes == NULL:
        return False
    start_ray(inner, keys, children, i, ray, object_.max_coordinate)
    inner.t, inner.t_key = far, t_key(far)
    inner.nodes, inner.leaves, inner.first_id = object_.nodes, object_.leaves, instance.first_id
    prefetch_child(inner.child, inner.nodes, inner.leaves)
    return True


@device
def _visit_leaf(inner, slot, lanes_at, wants_any, filter_):
    """Test the triangles of an object's leaf; returns whether the ray is done."""
    at = leaf_address(inner.leaves, inner.child)
    end = leaf_end(at, inner.child)
    while at != end:
        bits = test_block(at, slot_ray(inner), inner.t_min, inner.t, False, lanes_at)
        if bits != ZERO_U64:
            own = filter_of(filter_, inner)
            best = Best(
                _Best(address_of(inner)), _Best(address_of(slot)), inner.first_id, own, wants_any
            )
            if offer_hits(best, ZERO_U64, bits, HitLanes(lanes_at), BlockLanes(at).prim_ids):
                if wants_any:
                    return True
                inner.t_key = t_key(inner.t)
        at += BLOCK
    return False


@device
def _leave(slot, wants_any):
    """Return to the tree over the instances; returns the height of the ray's stack there."""
    if slot.prim_id != NO_PRIM:
        if wants_any:
            return LANE
        far = min(slot.t, local_limit(slot.best_t, slot.t_scale, slot.t_offset))
        slot.t, slot.t_key = far, t_key(far)
    return slot.top


@device
def _finish(slot, wants_any, out):
    """Write the result of a slot's ray, if it has one."""
    slot.t, slot.t_scale, slot.t_offset = slot.best_t, np.float64(1.0), np.float64(0.0)
    finish_ray(slot, wants_any, out)
    slot.ray = NO_RAY


@kernel
def trace_instance_wavefront(begin, end, top, frame, source, wants_any, filter_, out):
    """Trace rays begin to end through a scene's instances.

    Parameters
    ----------
    begin, end : int
    top : TopAddresses
        Of a scene without worlds, with a tree that is not empty.
    frame : SceneFrame
        Of the instances' boxes.
    source : RaySource
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    filter_ : HitFilter or None
    out : ResultAddresses
    """
    slots, lanes = scratch(_SLOTS_BYTES), scratch(_HITS_BYTES)
    all_keys, all_children = scratch(_STACK_BYTES), scratch(_STACK_BYTES)
    node, node_next = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
    leaf, leaf_next = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
    instance, instance_next = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
    left, done = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
    numbers = lane_numbers(i32x8)
    ray_next, ray_end = np.uint64(begin), np.uint64(end)
    # Lengths of the queues, in bytes.
    node_size, leaf_size, instance_size = ZERO_U64, ZERO_U64, ZERO_U64
    left_size, done_size = ZERO_U64, ZERO_U64
    tree = TreeRecord(top.trees)
    for k in range(IN_FLIGHT):
        store(done + done_size, k)
        done_size += _WORD
        slot = _Slot(slots, k)
        slot.ray, slot.nodes, slot.leaves = NO_RAY, tree.nodes, tree.leaves

    while True:
        # Step 1: write the results of finished rays and start new ones in their slots.
        at = ZERO_U64
        while at != done_size:
            k = load(np.uint64, done + at)
            at += _WORD
            slot = _Slot(slots, k)
            _finish(slot, wants_any, out)
            if ray_next < ray_end:
                keys, children = all_keys + k * STACK, all_children + k * STACK
                _start(slot, keys, children, ray_next, source, frame, top, out.status)
                ray_next += ONE_U64
                store(node + node_size, k)
                node_size += _WORD
        done_size = ZERO_U64
        if node_size | leaf_size | instance_size == ZERO_U64:
            break

        # Step 2: visit a node of either tree for each ray that waits for one.
        next_size, at = ZERO_U64, ZERO_U64
        while at != node_size:
            k = load(np.uint64, node + at)
            at += _WORD
            slot = _Slot(slots, k)
            keys, children = all_keys + k * STACK, all_children + k * STACK
            height = visit_node(
                slot, Node(slot.nodes, np.uint64(slot.child)), keys, children, numbers
            )
            child = next_child(slot, height, keys, children, slot, True)
            # Branchless: append the slot to all queues, and lengthen one of them.
            is_inside = np.uint64(k >= IN_FLIGHT)
            is_leaf = np.uint64(child < np.int32(0))
            is_end = np.uint64(child == BOTTOM)
            store(node_next + next_size, k)
            store(leaf + leaf_size, k)
            store(instance + instance_size, k)
            store(left + left_size, k)
            store(done + done_size, k)
            next_size += ((is_leaf | is_end) ^ ONE_U64) << _WORD_SHIFT
            leaf_size += (is_leaf & is_inside) << _WORD_SHIFT
            instance_size += (is_leaf & ~is_inside) << _WORD_SHIFT
            left_size += (is_end & is_inside) << _WORD_SHIFT
            done_size += (is_end & ~is_inside) << _WORD_SHIFT
        node, node_next = node_next, node
        node_size = next_size

        # Step 3: test a leaf of an object for each ray that waits for one.
        next_size, at = ZERO_U64, ZERO_U64
        while at != leaf_size:
            k = load(np.uint64, leaf + at)
            at += _WORD
            slot = _Slot(slots, k)
            keys, children = all_keys + k * STACK, all_children + k * STACK
            height = slot.top
            if _visit_leaf(slot, _Slot(slots, k - IN_FLIGHT), lanes, wants_any, filter_):
                height = LANE
            child = next_child(slot, height, keys, children, slot, True)
            is_leaf = np.uint64(child < np.int32(0))
            is_end = np.uint64(child == BOTTOM)
            store(node + node_size, k)
            store(leaf_next + next_size, k)
            store(left + left_size, k)
            node_size += ((is_leaf | is_end) ^ ONE_U64) << _WORD_SHIFT
            next_size += is_leaf << _WORD_SHIFT
            left_size += is_end << _WORD_SHIFT
        leaf, leaf_next = leaf_next, leaf
        leaf_size = next_size

        # Step 4: continue in the tree over the instances with the rays that left an object.
        at = ZERO_U64
        while at != left_size:
            k = load(np.uint64, left + at) - IN_FLIGHT
            at += _WORD
            slot = _Slot(slots, k)
            keys, children = all_keys + k * STACK, all_children + k * STACK
            child = next_child(slot, _leave(slot, wants_any), keys, children, slot, True)
            is_leaf = np.uint64(child < np.int32(0))
            is_end = np.uint64(child == BOTTOM)
            store(node + node_size, k)
            store(instance + instance_size, k)
            store(done + done_size, k)
            node_size += ((is_leaf | is_end) ^ ONE_U64) << _WORD_SHIFT
            instance_size += is_leaf << _WORD_SHIFT
            done_size += is_end << _WORD_SHIFT
        left_size = ZERO_U64

        # Step 5: enter an instance with each ray that has found one.
        next_size, at = ZERO_U64, ZERO_U64
        while at != instance_size:
            k = load(np.uint64, instance + at)
            at += _WORD
            slot = _Slot(slots, k)
            own = k + IN_FLIGHT
            if _enter(
                slot,
                _Slot(slots, own),
                all_keys + own * STACK,
                all_children + own * STACK,
                source,
                top.objects,
            ):
                store(node + node_size, own)
                node_size += _WORD
                continue
            keys, children = all_keys + k * STACK, all_children + k * STACK
            child = next_child(slot, slot.top, keys, children, slot, True)
            is_leaf = np.uint64(child < np.int32(0))
            is_end = np.uint64(child == BOTTOM)
            store(node + node_size, k)
            store(instance_next + next_size, k)
            store(done + done_size, k)
            node_size += ((is_leaf | is_end) ^ ONE_U64) << _WORD_SHIFT
            next_size += is_leaf << _WORD_SHIFT
            done_size += is_end << _WORD_SHIFT
        instance, instance_next = instance_next, instance
        instance_size = next_size
