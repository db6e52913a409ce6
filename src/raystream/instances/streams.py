"""Streams of groups through instances: the kernel for many rays that start near each other.

A list of groups descends the tree over the instances, as in `structures.bvh.group_stream`. At an
instance the rays of the list are moved to object space, 16 at a time, and descend the object's
tree as full groups; then their hits are merged with those from other instances. No ray waits for
others: what is kept of its hits depends on their distance and number only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.instances.merged_hits import OBJECT_TESTS, InstanceList, Merged, merge_hits
from raystream.instances.object_rays import load_rays
from raystream.instances.padding import padded_source
from raystream.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.instances.traversal import is_usual
from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import f32x16, load, scratch, store
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.ray_source import RaySource, load_direction
from raystream.structures.bvh.group_leaf import SMALL_BYTES, Small
from raystream.structures.bvh.group_rays import (
    FLAGS_AT,
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LISTS_AT,
    MEMORY_BYTES,
    PLACES_AT,
    RAY_BITS,
    Hot,
    load_block,
    store_block,
)
from raystream.structures.bvh.group_stream import (
    STREAM_STACK_BYTES,
    block_trace,
    leaf_visit,
    list_rays,
)
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.packet_load import set_slow
from raystream.structures.bvh.packet_rays import (
    Group,
    GroupLanes,
    GroupPlaces,
    first_ray,
)

#: Packets whose rays descend together. Their groups, and those of an instance, are in the L2 cache.
BLOCK_PACKETS = 8

#: Bytes that a call needs.
CALL_BYTES = 2 * -(-MEMORY_BYTES // 64) * 64

_PACKETS = np.uint64(BLOCK_PACKETS)
_LANES = np.uint64(16)
_LEAF_SHIFT = np.int32(3)
_INSIDE_AT = np.uint64(CALL_BYTES // 2)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_INVALID = np.uint8(RayStatus.INVALID)


class _InstanceTree(NamedTuple):
    """The tree over instances, and what their visit needs.

    Attributes
    ----------
    nodes, leaves, objects : uint64
        See `TreeRecord` and `TopAddresses`.
    source : RaySource
    filter : HitFilter or None
    inside, stack, small : uint64
        Memory for rays in object space, see `group_rays`; a stack; and bytes of a `Small`.
    """

    nodes: np.uint64
    leaves: np.uint64
    objects: np.uint64
    source: RaySource
    filter: HitFilter | None
    inside: np.uint64
    stack: np.uint64
    small: np.uint64


_trace_object = device(block_trace(leaf_visit(OBJECT_TESTS)))


@device_call
def _search_instance(tree, index, rays, count, scene, wants_any):
    """Search an instance with the rays of a list; returns the number of hits."""
    no_inline()
    instance = InstanceRecord(tree.leaves, index)
    object_ = ObjectRecord(tree.objects, np.uint64(instance.object_id))
    if object_.nodes == NULL:
        return ZERO_U64
    inside = tree.inside
    group_count, ray_count = load_rays(
        scene, inside, rays, count, tree.source, tree.leaves, index, tree.objects
    )
    if group_count == ZERO_U64:
        return ZERO_U64
    nodes = TreeAddresses(object_.nodes, object_.leaves)
    first_id = instance.first_id
    _trace_object(
        inside,
        inside + LISTS_AT,
        group_count,
        ray_count,
        nodes,
        tree.stack,
        Small(tree.small),
        wants_any,
        InstanceList(first_id, tree.filter, scene, rays, count - ONE_U64),
    )
    return merge_hits(scene, inside, rays, count, first_id, wants_any)


@device
def _visit_instance(tree, child, rays, memory, small, wants_any, filter_):  # noqa: ARG001
    at, count = rays.at, rays.length
    if rays.is_grouped:
        at, count = rays.room, list_rays(at, count, memory, rays.t_in, rays.room)
        if count == ZERO_U64:
            return ZERO_U64
    index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
    return _search_instance(tree, index, at, count, memory, wants_any)


_trace_scene = device(block_trace(_visit_instance))


@device
def _refuse(memory, groups, count, source):
    """Take rays whose directions are too long or too short out of a list; returns its length."""
    kept = ZERO_U64
    for j in range(count):
        packed = np.uint64(load(np.uint32, groups + j * np.uint64(4)))
        g = packed >> GROUP_SHIFT
        bits = packed & RAY_BITS
        if load(np.uint8, memory + FLAGS_AT + g) != np.uint8(0):
            bits &= _sound(memory, g, bits, source)
        store(groups + kept * np.uint64(4), np.uint32((g << GROUP_SHIFT) | bits))
        kept += np.uint64(bits != ZERO_U64)
    return kept


@device_call
def _sound(memory, g, bits, source):
    """The rays of a group whose directions have lengths within bounds."""
    no_inline()
    lanes, sound = GroupLanes(memory, g), ZERO_U64
    first = first_ray(GroupPlaces(memory + PLACES_AT, ZERO_U64, ZERO_U64), g)
    for k in range(_LANES):
        if (bits >> k) & ONE_U64 == ZERO_U64:
            continue
        x, y, z = load_direction(source.rays, first + k)
        if is_usual(x, y, z):
            sound |= ONE_U64 << k
            continue
        store(source.status + first + k, _INVALID)
        hot = Hot(memory + HOT_AT, (g << LANE_SHIFT) | k)
        lanes.t_min[k], lanes.t[k], hot.t_min, hot.t = _INF, -_INF, _INF, -_INF
    return sound


@device
def _finish(memory, group_count):
    """Make the distances of all groups those that are reported."""
    for g in range(group_count):
        group = Group(memory, g)
        group.t, group.t_scale = Merged(memory, g).t + _ZERO, f32x16(np.float32(1.0))
        set_slow(group)


@kernel
def trace_instances(begin, end, top, source, wants_any, filter_, out, memory):
    """Trace packets begin to end through a scene's instances.

    Parameters
    ----------
    begin, end : int
    top : TopAddresses
        Of a scene without worlds, with a tree that is not empty.
    source : PacketSource
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    filter_ : HitFilter or None
    out : ResultAddresses
    memory : int
        Address of `CALL_BYTES` bytes; a multiple of 64.
    """
    memory = np.uint64(memory)
    inside = memory + _INSIDE_AT
    stack, inner_stack = scratch(STREAM_STACK_BYTES), scratch(STREAM_STACK_BYTES)
    small, inner_small = scratch(SMALL_BYTES), scratch(SMALL_BYTES)
    record = TreeRecord(top.trees)
    tree = _InstanceTree(
        record.nodes,
        record.leaves,
        top.objects,
        source.rays,
        filter_,
        inside,
        inner_stack,
        inner_small,
    )
    groups = memory + LISTS_AT
    for first in range(np.uint64(begin), np.uint64(end), _PACKETS):
        last = min(first + _PACKETS, np.uint64(end))
        group_count, padded = padded_source(source, top, first, last)
        count, ray_count = load_block(memory, padded, first, last, groups, True)
        count = _refuse(memory, groups, count, source)
        _trace_scene(memory, groups, count, ray_count, tree, stack, Small(small), wants_any, None)
        _finish(memory, group_count)
        store_block(memory, source.order, first, last, wants_any, out)
