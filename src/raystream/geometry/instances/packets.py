"""Packets of 256 rays through instances: the kernel for coherent rays.

A packet traverses the tree over the instances, as in `structures.bvh.walks.packet`. At an instance,
the groups with a ray that enters its box are moved to object space and traverse the object's tree
as a packet of their own; then their hits are merged with those from other instances.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.instances.object_rays import (
    WORLD_BYTES,
    World,
    WorldLanes,
    load_in_object,
    read_into,
)
from raystream.geometry.instances.padding import drop_invalid, padded_source
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.jit.constants import INF_F32, NULL, ONE_F32, ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    any_lane,
    count_trailing_zeros,
    f32x16,
    lanes_from_bits,
    mask16,
    mask_bits,
    scratch,
    select,
    store,
)
from raystream.jit.views import address_of
from raystream.kernels.best import shorten_lanes
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.leaf_kinds import InstanceHits, leaf_within, scene_group
from raystream.structures.bvh.node_layout import prefetch_child
from raystream.structures.bvh.packets.filters import rays_that_enter
from raystream.structures.bvh.packets.leaf import Kind, Within, entering_rays
from raystream.structures.bvh.packets.load import load_packet, prepare_group, set_slow
from raystream.structures.bvh.packets.queries import PacketScene
from raystream.structures.bvh.packets.rays import (
    GROUPS,
    NO_CLASS,
    PACKET_BYTES,
    Group,
    GroupLanes,
    group_rows,
)
from raystream.structures.bvh.walks.packet import TRACE_BYTES, packet_walk

_LANES = np.uint64(16)
_LEAF_SHIFT = np.int32(3)
_WORLDS_BYTES = int(GROUPS) * WORLD_BYTES
_NUMBERS_BYTES = int(GROUPS)


class _InstanceLeaf(NamedTuple):
    """Leaves of the tree over instances, see `walks.packet.trace_packet`; what their visit needs.

    Attributes
    ----------
    visit, prefetch : device function
    kind : Kind
        Of the leaves of objects.
    objects : uint64
        See `TopAddresses`.
    worlds : uint64
        Address of the packet's rays in world space: a `World` for each group.
    packet, memory, groups : uint64
        Memory for a packet in object space, for its trace, and for the numbers of its groups.
    """

    visit: Any
    prefetch: Any
    kind: Kind
    objects: np.uint64
    worlds: np.uint64
    packet: np.uint64
    memory: np.uint64
    groups: np.uint64


_trace_object, _trace_top = packet_walk(), packet_walk()


@device
def _load_groups(inside, packet, box, rays, groups, instance, object_):
    """Load the groups that enter an instance's box in object space; returns their number."""
    count = ZERO_U64
    while groups != ZERO_U64:
        g = count_trailing_zeros(groups)
        groups &= groups - ONE_U64
        bits = entering_rays(packet, g, box, rays)
        bits = rays_that_enter(inside.kind.filter, g, bits, instance.mask)
        if bits == ZERO_U64:
            continue
        hits, world = InstanceHits(packet, g), World(inside.worlds, g)
        group = Group(inside.packet, count)
        world.best_t, world.best = hits.t, hits.prim_id
        load_in_object(address_of(group), address_of(world), instance, object_)
        enters = lanes_from_bits(mask16, bits)
        group.t = select(enters, group.t, f32x16(-INF_F32))
        prepare_group(group, object_.max_coordinate)
        store(inside.groups + count, np.uint8(g))
        count += np.uint64(mask_bits(group.direction_class != NO_CLASS) != ZERO_U64)
    return count


@device_call
def _search_instance(inside, packet, index, leaves, box, rays, groups):
    """Search an instance with groups of a packet; returns whether a ray's search is shorter now."""
    no_inline()
    instance = InstanceRecord(leaves, index)
    object_ = ObjectRecord(inside.objects, np.uint64(instance.object_id))
    if object_.nodes == NULL:
        return False
    count = _load_groups(inside, packet, box, rays, groups, instance, object_)
    if count == ZERO_U64:
        return False
    tree = TreeAddresses(object_.nodes, object_.leaves)
    within = Within(packet, inside.groups, instance.first_id)
    leaf = leaf_within(inside.kind, within)
    _trace_object(inside.packet, count, tree, object_.max_coordinate, inside.memory, leaf)
    has_hit = False
    for k in range(count):
        g = scene_group(within, k)
        hits = InstanceHits(packet, g)
        found = hits.prim_id != World(inside.worlds, g).best
        if any_lane(found):
            has_hit = True
            shorten_lanes(within.first_id, hits, found, hits.t, inside.kind.wants_any)
    return has_hit


@device
def _visit_instance(leaf, packet, child, leaves, box, rays, groups, own):  # noqa: ARG001
    index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
    return _search_instance(leaf, packet, index, leaves, box, rays, groups)


@device
def _read_rays(packet, number, worlds, slow_groups, source):
    """Read a packet's rays in world space."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
        world = WorldLanes(worlds, g)
        if not is_slow:
            set_slow(Group(packet, g))
        hits, lanes = InstanceHits(packet, g), GroupLanes(packet, g)
        hits.t = f32x16(INF_F32)
        if count == ZERO_U64:
            continue
        for k in range(_LANES):
            read_into(world, k, source.rays, first + min(k, count - ONE_U64))
        hits.t = World(worlds, g).best_t
        if is_slow:
            drop_invalid(lanes, first, count, source)


@device
def _load(packet, number, source, top, worlds):
    padded = padded_source(source, top, number, number + ONE_U64)
    slow_groups = load_packet(packet, number, padded)
    _read_rays(packet, number, worlds, slow_groups, padded)
    return slow_groups, padded.frame.max_coordinate


@device
def _trace(packet, top, max_coordinate, worlds, leaf):
    inside, groups = scratch(PACKET_BYTES), scratch(_NUMBERS_BYTES)
    own = _InstanceLeaf(
        _visit_instance,
        prefetch_child,
        leaf.kind,
        top.objects,
        worlds,
        inside,
        scratch(TRACE_BYTES),
        groups,
    )
    record = TreeRecord(top.trees)
    tree = TreeAddresses(record.nodes, record.leaves)
    _trace_top(packet, GROUPS, tree, max_coordinate, scratch(TRACE_BYTES), own)
    # From now on, all distances are the reported ones.
    for g in range(GROUPS):
        group = Group(packet, g)
        group.t, group.t_scale = InstanceHits(packet, g).t + ZERO_F32, f32x16(ONE_F32)
        set_slow(group)


#: Of instances without worlds: `TopAddresses`, with a tree that is not empty.
INSTANCES = PacketScene(_load, _trace, _WORLDS_BYTES)
