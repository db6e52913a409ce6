"""Many single rays in flight through instances: the kernel for incoherent rays.

As `structures.bvh.walks.in_flight`, which hides that a ray waits for memory at every node. A ray
has two slots with a stack each: one in the tree over the instances, and one in the tree of the
object that it is in. What it needs next, in either, decides in which queue it waits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.rays import INVALID
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.geometry.instances.traversal import load_scene_ray
from raystream.jit.constants import INF_F32, NULL, ONE_F64, ONE_U64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import scratch, store
from raystream.jit.views import address_of, view
from raystream.kernels.best import Best, best_views, offer_hits
from raystream.kernels.hit_filter import may_enter
from raystream.kernels.leaf_block import HITS, BlockLanes
from raystream.kernels.ray import local_limit
from raystream.kernels.ray_source import load_ray
from raystream.kernels.search import InstanceRay
from raystream.structures.bvh.node_layout import LANE, leaf_address, prefetch_child, t_key
from raystream.structures.bvh.walks.all_hits import SlotSearches, search_leaf
from raystream.structures.bvh.walks.in_flight import (
    IN_FLIGHT,
    NO_PRIM,
    NO_RAY,
    QUEUE_BYTES,
    SLOT,
    STACK,
    append,
    filter_of,
    finish_ray,
    item,
    next_child,
    start_ray,
    test_leaf,
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
_SLOTS_BYTES, _STACKS_BYTES = int(_SLOTS) * _SLOT.itemsize, int(_SLOTS * STACK)
_HITS_BYTES = HITS.itemsize


@device
def _start(slot, stack, i, source, frame, top, status):
    """Put ray i into a slot, before the root of the tree over the instances."""
    ray, most, _ = load_scene_ray(source, i, top, frame)
    if ray.status == INVALID:
        store(status + i, INVALID)
    start_ray(slot, stack, i, ray, most)
    slot.best_t = INF_F32


@device
def _enter(slot, inner, stack, source, objects, filter_):
    """Put a ray into the slot for objects, before the root of its next instance's object.

    Returns whether anything is to be searched there.
    """
    instance = InstanceRecord(leaf_address(slot.leaves, slot.child))
    if not may_enter(filter_of(filter_, slot), instance.mask):
        return False
    object_ = ObjectRecord(objects, np.uint64(instance.object_id))
    i = np.uint64(slot.ray)
    ray = load_ray(source, i, object_, instance)
    far = ray.t_max
    if slot.prim_id != NO_PRIM:
        far = min(far, local_limit(slot.best_t, ray.t_scale, ray.t_offset))
    if not (ray.t_min <= far) or object_.nodes == NULL:
        return False
    start_ray(inner, stack, i, ray, object_.max_coordinate)
    inner.t, inner.t_key = far, t_key(far)
    inner.nodes, inner.leaves, inner.first_id = object_.nodes, object_.leaves, instance.first_id
    prefetch_child(inner.child, inner.nodes, inner.leaves)
    return True


@device
def _keep(inner, at, bits, lanes, given):
    """Keep the nearest hit of a ray in an object; see `walks.in_flight.test_leaf`."""
    slot, wanted = given
    of_ray, of_scene = _Best(address_of(inner)), _Best(address_of(slot))
    best = Best(of_ray, of_scene, inner.first_id, filter_of(wanted.filter, inner), wanted.wants_any)
    is_kept = offer_hits(best, ZERO_U64, bits, lanes, BlockLanes(at).prim_ids)
    if is_kept:
        inner.t_key = t_key(inner.t)
    return is_kept and wanted.wants_any


@device
def _visit_leaf(inner, slot, lanes, wanted):
    return test_leaf(inner, inner.leaves, lanes, _keep, (slot, wanted))


@device
def _leave(slot, wanted):
    """Return to the tree over the instances; returns the height of the ray's stack there."""
    if slot.prim_id != NO_PRIM:
        if wanted.wants_any:
            return LANE
        far = min(slot.t, local_limit(slot.best_t, slot.t_scale, slot.t_offset))
        slot.t, slot.t_key = far, t_key(far)
    return slot.top


def instance_wavefront_kernel(visit_leaf, finish):
    """Make the kernel for rays in flight through instances.

    Parameters
    ----------
    visit_leaf : device function
        ``visit_leaf(inner, slot, lanes, wanted)`` tests the triangles of the next leaf of the slot
        for objects, and keeps their hits; returns whether the ray is done. `slot` is the ray's
        other one, `lanes` the address of `HITS`.
    finish : device function
        See `structures.bvh.walks.in_flight.wavefront_kernel`.

    Returns
    -------
    kernel
        ``trace_wavefront(begin, end, top, frame, source, wanted)`` traces rays begin to end through
        a scene's instances.

        top : TopAddresses
            Of a scene without worlds, with a tree that is not empty.
        frame : SceneFrame
            Of the instances' boxes.
        source : RaySource
        wanted : NamedTuple
            As the functions take it, with ``out``, a `ResultAddresses`.
    """

    @kernel
    def trace_wavefront(begin, end, top, frame, source, wanted):
        slots, stacks = scratch(_SLOTS_BYTES), scratch(_STACKS_BYTES)
        lanes = scratch(_HITS_BYTES)
        # Slots by what their rays need next: a node of either tree, a leaf of an object, an
        # instance, to leave an object, or nothing more.
        node, leaf, instance = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
        left, done = scratch(QUEUE_BYTES), scratch(QUEUE_BYTES)
        node_count, leaf_count, instance_count = ZERO_U64, ZERO_U64, ZERO_U64
        left_count, done_count = ZERO_U64, ZERO_U64
        ray_next, ray_end = np.uint64(begin), np.uint64(end)
        tree = TreeRecord(top.trees)
        for k in range(IN_FLIGHT):
            done_count = append(done, done_count, k, ONE_U64)
            slot = _Slot(slots, k)
            slot.ray, slot.nodes, slot.leaves = NO_RAY, tree.nodes, tree.leaves

        while True:
            # Step 1: write the results of finished rays and start new ones in their slots.
            for j in range(done_count):
                k = item(done, j)
                slot = _Slot(slots, k)
                # The reported t needs no conversion.
                slot.t, slot.t_scale, slot.t_offset = slot.best_t, ONE_F64, ZERO_F64
                finish(slot, wanted)
                if ray_next < ray_end:
                    _start(
                        slot, stacks + k * STACK, ray_next, source, frame, top, wanted.out.status
                    )
                    ray_next += ONE_U64
                    node_count = append(node, node_count, k, ONE_U64)
            done_count = ZERO_U64
            if node_count | leaf_count | instance_count == ZERO_U64:
                break

            # Step 2: visit a node of either tree for each ray that waits for one. A queue is
            # written where it has been read already.
            waiting, node_count = node_count, ZERO_U64
            for j in range(waiting):
                k = item(node, j)
                slot, stack = _Slot(slots, k), stacks + k * STACK
                height = visit_node(slot, slot.nodes, stack)
                is_node, is_leaf, is_end = next_child(slot, height, stack, slot, True)
                is_inside = np.uint64(k >= IN_FLIGHT)
                node_count = append(node, node_count, k, is_node)
                leaf_count = append(leaf, leaf_count, k, is_leaf & is_inside)
                instance_count = append(instance, instance_count, k, is_leaf & ~is_inside)
                left_count = append(left, left_count, k, is_end & is_inside)
                done_count = append(done, done_count, k, is_end & ~is_inside)

            # Step 3: test a leaf of an object for each ray that waits for one.
            waiting, leaf_count = leaf_count, ZERO_U64
            for j in range(waiting):
                k = item(leaf, j)
                slot, stack = _Slot(slots, k), stacks + k * STACK
                is_done = visit_leaf(slot, _Slot(slots, k - IN_FLIGHT), lanes, wanted)
                height = LANE if is_done else slot.top
                is_node, is_leaf, is_end = next_child(slot, height, stack, slot, True)
                node_count = append(node, node_count, k, is_node)
                leaf_count = append(leaf, leaf_count, k, is_leaf)
                left_count = append(left, left_count, k, is_end)

            # Step 4: continue in the tree over the instances with the rays that left an object.
            for j in range(left_count):
                k = item(left, j) - IN_FLIGHT
                slot, stack = _Slot(slots, k), stacks + k * STACK
                height = _leave(slot, wanted)
                is_node, is_leaf, is_end = next_child(slot, height, stack, slot, True)
                node_count = append(node, node_count, k, is_node)
                instance_count = append(instance, instance_count, k, is_leaf)
                done_count = append(done, done_count, k, is_end)
            left_count = ZERO_U64

            # Step 5: enter an instance with each ray that has found one.
            waiting, instance_count = instance_count, ZERO_U64
            for j in range(waiting):
                k = item(instance, j)
                slot, own = _Slot(slots, k), k + IN_FLIGHT
                inner, stack = _Slot(slots, own), stacks + own * STACK
                if _enter(slot, inner, stack, source, top.objects, wanted.filter):
                    node_count = append(node, node_count, own, ONE_U64)
                    continue
                is_node, is_leaf, is_end = next_child(
                    slot, slot.top, stacks + k * STACK, slot, True
                )
                node_count = append(node, node_count, k, is_node)
                instance_count = append(instance, instance_count, k, is_leaf)
                done_count = append(done, done_count, k, is_end)

    return trace_wavefront


#: The nearest or any hits, for a `NearestWanted`.
trace_instance_wavefront = instance_wavefront_kernel(_visit_leaf, finish_ray)


def instance_hits_in_flight(searches: SlotSearches) -> Any:
    """The kernel of `SlotSearches` through instances."""
    begin, end, finish = searches

    @device
    def visit_leaf(inner, slot, lanes, wanted):  # noqa: ARG001
        instance = InstanceRay(inner.t_scale, inner.t_offset, inner.first_id)
        search = begin(inner, wanted, instance)
        return end(slot, search_leaf(inner, inner.leaves, search), wanted)

    return instance_wavefront_kernel(visit_leaf, finish)
