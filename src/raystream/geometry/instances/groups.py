"""Streams of groups through instances: the kernel for many rays that start near each other.

A list of groups descends the tree over the instances, as in `structures.bvh.walks.groups`. At an
instance the rays of the list are moved to object space, 16 at a time, and descend the object's
tree as full groups; then their hits are merged with those from other instances. No ray waits for
others: what is kept of its hits depends on their distance and number only.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.instances.merged_hits import (
    InstanceList,
    Merged,
    admitted_rays,
    merge_hits,
    object_leaf,
)
from raystream.geometry.instances.object_rays import load_rays
from raystream.geometry.instances.padding import drop_invalid, padded_source
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.jit.constants import NULL, ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import f32x16, load, mask_bits, scratch, store
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packets.load import set_slow
from raystream.structures.bvh.packets.rays import Group, GroupLanes, entry_rows
from raystream.structures.bvh.ray_groups.leaf import SMALL_BYTES, Small
from raystream.structures.bvh.ray_groups.queries import finish_nearest, group_kernel
from raystream.structures.bvh.ray_groups.rays import (
    FLAGS_AT,
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LISTS_AT,
    MEMORY_BYTES,
    PLACES_AT,
    Hot,
    load_block,
)
from raystream.structures.bvh.walks.groups import STREAM_STACK_BYTES, group_walk, list_rays

#: Packets whose rays descend together. Their groups, and those of an instance, are in the L2 cache.
BLOCK_PACKETS = 8

#: Bytes that a call needs.
CALL_BYTES = 2 * -(-MEMORY_BYTES // 64) * 64

_LANES = np.uint64(16)
_LEAF_SHIFT = np.int32(3)
_INSIDE_AT = np.uint64(CALL_BYTES // 2)


class _InstanceLeaf(NamedTuple):
    """Leaves of the tree over instances, see `walks.groups.trace_block`; and what they need.

    Attributes
    ----------
    visit : device function
    objects : uint64
        See `TopAddresses`.
    source : RaySource
    wants_any : bool
    filter : HitFilter or None
    inside, stack, small : uint64
        Memory for rays in object space, see `group_rays`; a stack; and bytes of a `Small`.
    """

    visit: Any
    objects: np.uint64
    source: RaySource
    wants_any: bool
    filter: HitFilter | None
    inside: np.uint64
    stack: np.uint64
    small: np.uint64


_trace_object, _trace_top = group_walk(), group_walk()


@device_call
def _search_instance(leaf, leaves, index, rays, count, scene):
    """Search an instance with the rays of a list; returns the number of hits."""
    no_inline()
    instance = InstanceRecord(leaves, index)
    object_ = ObjectRecord(leaf.objects, np.uint64(instance.object_id))
    if object_.nodes == NULL:
        return ZERO_U64
    inside, wants_any, first_id = leaf.inside, leaf.wants_any, instance.first_id
    group_count, ray_count = load_rays(
        scene, inside, rays, count, leaf.source, leaves, index, leaf.objects
    )
    if group_count == ZERO_U64:
        return ZERO_U64
    tree = TreeAddresses(object_.nodes, object_.leaves)
    own = object_leaf(wants_any, InstanceList(first_id, leaf.filter, scene, rays, count - ONE_U64))
    groups, small = inside + LISTS_AT, Small(leaf.small)
    _trace_object(inside, groups, group_count, ray_count, tree, leaf.stack, small, own)
    return merge_hits(scene, inside, rays, count, first_id, wants_any)


@device
def _visit_instance(leaf, tree, child, rays, memory, small):  # noqa: ARG001
    index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
    mask = InstanceRecord(tree.leaves, index).mask
    at, count = rays.at, admitted_rays(leaf.filter, mask, memory, rays)
    if rays.is_grouped:
        at, count = rays.room, list_rays(at, count, memory, rays.t_in, rays.room)
    if count == ZERO_U64:
        return ZERO_U64
    return _search_instance(leaf, tree.leaves, index, at, count, memory)


@device
def _list_valid(memory, group_count, source):
    """Drop invalid rays, and list the groups without them; returns the length of the list."""
    groups, count = memory + LISTS_AT, ZERO_U64
    for g in range(group_count):
        if load(np.uint8, memory + FLAGS_AT + g) != np.uint8(0):
            lanes, hot_at = GroupLanes(memory, g), memory + HOT_AT
            drop_invalid(lanes, *entry_rows(memory + PLACES_AT, g), source)
            for k in range(_LANES):
                hot = Hot(hot_at, (g << LANE_SHIFT) | k)
                hot.t_min, hot.t = lanes.t_min[k], lanes.t[k]
        group = Group(memory, g)
        bits = mask_bits(group.t_min <= group.t)
        store(groups + count * LANE, np.uint32((g << GROUP_SHIFT) | bits))
        count += np.uint64(bits != ZERO_U64)
    return count


@device
def _load(memory, source, first, last, top, wanted):  # noqa: ARG001
    padded = padded_source(source, top, first, last)
    _, ray_count, group_count = load_block(memory, padded, first, last, True)
    return _list_valid(memory, group_count, source), ray_count, group_count


@device
def _trace(memory, count, ray_count, top, source, wanted):
    leaf = _InstanceLeaf(
        _visit_instance,
        top.objects,
        source.rays,
        wanted.wants_any,
        wanted.filter,
        memory + _INSIDE_AT,
        scratch(STREAM_STACK_BYTES),
        scratch(SMALL_BYTES),
    )
    record = TreeRecord(top.trees)
    tree = TreeAddresses(record.nodes, record.leaves)
    stack, small = scratch(STREAM_STACK_BYTES), Small(scratch(SMALL_BYTES))
    _trace_top(memory, memory + LISTS_AT, count, ray_count, tree, stack, small, leaf)


@device
def _finish(memory, source, first, last, top, group_count, wanted):
    # From now on, all distances are the reported ones.
    for g in range(group_count):
        group = Group(memory, g)
        group.t, group.t_scale = Merged(memory, g).t + ZERO_F32, f32x16(np.float32(1.0))
        set_slow(group)
    return finish_nearest(memory, source, first, last, top, group_count, wanted)


#: The nearest or any hits of instances without worlds: `TopAddresses`, with a tree that is not
#: empty. For a `NearestWanted`; in `CALL_BYTES` bytes.
trace_instances = group_kernel(_load, _trace, _finish, BLOCK_PACKETS)
