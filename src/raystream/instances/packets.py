"""Packets of 256 rays through instances: the kernel for coherent rays.

A packet traverses the tree over the instances, as in `structures.bvh.packet`. At an instance, the
groups with a ray that enters its box are moved to object space and traverse the object's tree as a
packet of their own; then their hits are merged with those from other instances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.instances.merged_hits import (
    PacketGroup,
    keep_packet_hits,
    numbers_within,
    visit_object_leaf,
)
from raystream.instances.object_rays import WORLD_BYTES, World, WorldLanes, load_group
from raystream.instances.padding import padded_source
from raystream.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.instances.traversal import is_usual, ray_numbers
from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    f32x16,
    lanes_from_bits,
    load,
    mask16,
    mask_bits,
    scratch,
    select,
    store,
)
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.node_layout import prefetch_child
from raystream.structures.bvh.packet import TRACE_BYTES, packet_trace
from raystream.structures.bvh.packet_leaf import ANY, FIRST, entering_rays
from raystream.structures.bvh.packet_load import load_packet, prepare_group, set_slow
from raystream.structures.bvh.packet_rays import (
    GROUPS,
    NO_CLASS,
    PACKET_BYTES,
    Group,
    GroupLanes,
    group_rows,
    store_packet,
)

_LANES = np.uint64(16)
_LEAF_SHIFT = np.int32(3)
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_INF = np.float32(np.inf)
_INVALID = np.uint8(RayStatus.INVALID)
_WORLDS_BYTES = int(GROUPS) * WORLD_BYTES
_NUMBERS_BYTES = int(GROUPS)


class _Inside(NamedTuple):
    """What the visit of an instance needs.

    Attributes
    ----------
    objects : uint64
        See `TopAddresses`.
    worlds : uint64
        Address of the packet's rays in world space: a `World` for each group.
    packet, memory, groups : uint64
        Memory for a packet in object space, for its trace, and for the numbers of its groups.
    """

    objects: np.uint64
    worlds: np.uint64
    packet: np.uint64
    memory: np.uint64
    groups: np.uint64


_trace_object = packet_trace(visit_object_leaf, prefetch_child)


@device
def _load_groups(packet, inside, box, rays, groups, instance, object_):
    """Load the groups that enter an instance's box in object space; returns their number."""
    count = ZERO_U64
    for g in range(groups.first, groups.last + ONE_U64):
        bits = entering_rays(packet, g, box, rays)
        if bits == ZERO_U64:
            continue
        scene, world = PacketGroup(packet, g), World(inside.worlds, g)
        world.best_t = scene.best_t
        world.best = numbers_within(scene.prim_id, instance.first_id)
        own, group = PacketGroup(inside.packet, count), Group(inside.packet, count)
        load_group(own, world, instance, object_)
        enters = lanes_from_bits(mask16, bits)
        group.t = select(enters, group.t, f32x16(-_INF))
        prepare_group(group, object_.max_coordinate)
        own.prim_id, own.best_t = world.best, world.best_t
        store(inside.groups + count, np.uint8(g))
        count += np.uint64(mask_bits(group.direction_class != NO_CLASS) != ZERO_U64)
    return count


@device_call
def _search_instance(packet, index, leaves, box, rays, groups, goal, inside):
    """Search an instance with groups of a packet; returns whether any ray has a nearer hit."""
    no_inline()
    instance = InstanceRecord(leaves, index)
    object_ = ObjectRecord(inside.objects, np.uint64(instance.object_id))
    if object_.nodes == NULL:
        return False
    count = _load_groups(packet, inside, box, rays, groups, instance, object_)
    if count == ZERO_U64:
        return False
    tree = TreeAddresses(object_.nodes, object_.leaves)
    most = object_.max_coordinate
    _trace_object(inside.packet, count, tree, most, inside.memory, goal, ZERO_U64, None)
    has_hit = False
    for k in range(count):
        scene = PacketGroup(packet, np.uint64(load(np.uint8, inside.groups + k)))
        own = PacketGroup(inside.packet, k)
        if keep_packet_hits(scene, own, instance.first_id, goal == ANY):
            has_hit = True
    return has_hit


@device
def _visit_instance(packet, child, leaves, box, rays, groups, own, goal, inside, filter_):  # noqa: ARG001
    index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
    return _search_instance(packet, index, leaves, box, rays, groups, goal, inside)


_trace_scene = packet_trace(_visit_instance, prefetch_child)


@device
def _read_rays(packet, number, worlds, slow_groups, source):
    """Read a packet's rays in world space, and refuse directions that are too long or short."""
    for g in range(GROUPS):
        first, count = group_rows(source.order, number, g)
        is_slow = (slow_groups >> g) & ONE_U64 != ZERO_U64
        group, world = Group(packet, g), WorldLanes(worlds, g)
        if not is_slow:
            set_slow(group)
        own, lanes = PacketGroup(packet, g), GroupLanes(packet, g)
        own.best_t = f32x16(_INF)
        if count == ZERO_U64:
            continue
        origin, direction = world.origin, world.direction
        for k in range(_LANES):
            ox, oy, oz, dx, dy, dz, t_min, t_max = ray_numbers(
                source.rays, first + min(k, count - ONE_U64)
            )
            origin[ZERO_U64, k], origin[ONE_U64, k], origin[np.uint64(2), k] = ox, oy, oz
            direction[ZERO_U64, k], direction[ONE_U64, k], direction[np.uint64(2), k] = dx, dy, dz
            world.t_min[k], world.best_t[k] = t_min, t_max
            if is_slow and k < count and not is_usual(dx, dy, dz):
                store(source.status + first + k, _INVALID)
                lanes.t[k], lanes.t_min[k], lanes.direction_class[k] = -_INF, _INF, NO_CLASS
        own.best_t = World(worlds, g).best_t


@device
def _finish(packet):
    """Make the distances of all groups those that are reported."""
    for g in range(GROUPS):
        group = Group(packet, g)
        group.t, group.t_scale = PacketGroup(packet, g).best_t + _ZERO, f32x16(_ONE)
        set_slow(group)


@kernel
def trace_instance_packets(begin, end, top, source, wants_any, out):
    """Trace packets begin to end through a scene's instances.

    Parameters
    ----------
    begin, end : int
    top : TopAddresses
        Of a scene without worlds, with a tree that is not empty.
    source : PacketSource
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    out : ResultAddresses
    """
    packet, memory, worlds = scratch(PACKET_BYTES), scratch(TRACE_BYTES), scratch(_WORLDS_BYTES)
    inside = _Inside(
        top.objects, worlds, scratch(PACKET_BYTES), scratch(TRACE_BYTES), scratch(_NUMBERS_BYTES)
    )
    record = TreeRecord(top.trees)
    tree = TreeAddresses(record.nodes, record.leaves)
    goal = ANY if wants_any else FIRST
    for number in range(np.uint64(begin), np.uint64(end)):
        _, padded = padded_source(source, top, number, number + ONE_U64)
        slow_groups = load_packet(packet, number, padded)
        _read_rays(packet, number, worlds, slow_groups, padded)
        most = padded.frame.max_coordinate
        _trace_scene(packet, GROUPS, tree, most, memory, goal, inside, None)
        _finish(packet)
        store_packet(packet, number, source.order, slow_groups, wants_any, out)
