"""Packets of 256 rays through instances: the kernel for coherent rays.

A packet traverses the tree over the instances, as in `structures.bvh.packet`. At an instance, the
groups with a ray that enters its box are moved to object space and traverse the object's tree as a
packet of their own; then their hits are merged with those from other instances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.instances.object_rays import WORLD_BYTES, World, WorldLanes, load_group
from raystream.instances.padding import padded_source
from raystream.instances.records import InstanceRecord, ObjectRecord, TreeRecord
from raystream.instances.traversal import is_usual, ray_numbers
from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    any_lane,
    f32x16,
    lanes_from_bits,
    load,
    mask16,
    mask_bits,
    scratch,
    select,
    store,
)
from raystream.kernels.best import Best, best_views, offer_hits, offer_lanes, shorten_lanes
from raystream.structures.bvh.layout import TreeAddresses
from raystream.structures.bvh.node_layout import prefetch_child
from raystream.structures.bvh.packet import TRACE_BYTES, packet_trace
from raystream.structures.bvh.packet_filter import lanes_filter, packet_filter, ray_filter
from raystream.structures.bvh.packet_leaf import ANY, FIRST, entering_rays, leaf_visit
from raystream.structures.bvh.packet_load import load_packet, prepare_group, set_slow
from raystream.structures.bvh.packet_rays import (
    GROUP,
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
_ALL_GROUPS = np.uint64(2**64 - 1)


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


class _Within(NamedTuple):
    """What the groups in an instance are of the scene's packet, which has their rays' hits.

    Attributes
    ----------
    scene, groups : uint64
        Addresses of the packet, and of the numbers of these groups there.
    first_id : int32
        See `kernels.best.Best`.
    """

    scene: np.uint64
    groups: np.uint64
    first_id: np.int32


#: A group in a scene or an instance, see `kernels.best`.
_Hits, _HitsLanes = best_views(
    GROUP, limit="t_active", t="t_scale", t_scale="slow_t_scale", t_offset="slow_t_offset"
)


@device
def _scene_group(within, g):
    return np.uint64(load(np.uint8, within.groups + g))


@device
def _keep_in_group(packet, g, taken, t, uv, prim_id, goal, within, filter_):
    u, v = uv
    to = _scene_group(within, g)
    own = lanes_filter(filter_, Group(packet, g), to)
    best = Best(_Hits(packet, g), _Hits(within.scene, to), within.first_id, own, goal == ANY)
    return offer_lanes(best, taken, t, u, v, prim_id) != ZERO_U64


@device
def _keep_of_ray(packet, g, k, bits, found, prim_ids, goal, within, filter_):
    to, ray = _scene_group(within, g), _HitsLanes(packet, g)
    own = ray_filter(filter_, GroupLanes(packet, g), to, k)
    best = Best(ray, _HitsLanes(within.scene, to), within.first_id, own, goal == ANY)
    return offer_hits(best, k, bits, found, prim_ids)


_trace_object = packet_trace(leaf_visit(_keep_in_group, _keep_of_ray), prefetch_child)


@device
def _load_groups(packet, inside, box, rays, groups, instance, object_):
    """Load the groups that enter an instance's box in object space; returns their number."""
    count = ZERO_U64
    for g in range(groups.first, groups.last + ONE_U64):
        bits = entering_rays(packet, g, box, rays)
        if bits == ZERO_U64:
            continue
        hits, world, group = _Hits(packet, g), World(inside.worlds, g), Group(inside.packet, count)
        world.best_t, world.best = hits.t, hits.prim_id
        load_group(group, world, instance, object_)
        enters = lanes_from_bits(mask16, bits)
        group.t = select(enters, group.t, f32x16(-_INF))
        prepare_group(group, object_.max_coordinate)
        store(inside.groups + count, np.uint8(g))
        count += np.uint64(mask_bits(group.direction_class != NO_CLASS) != ZERO_U64)
    return count


@device_call
def _search_instance(packet, index, leaves, box, rays, groups, goal, inside, filter_):
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
    most, within = object_.max_coordinate, _Within(packet, inside.groups, instance.first_id)
    _trace_object(inside.packet, count, tree, most, inside.memory, goal, within, filter_)
    has_hit = False
    for k in range(count):
        g = _scene_group(within, k)
        hits = _Hits(packet, g)
        found = hits.prim_id != World(inside.worlds, g).best
        if any_lane(found):
            has_hit = True
            shorten_lanes(within.first_id, hits, found, hits.t, goal == ANY)
    return has_hit


@device
def _visit_instance(packet, child, leaves, box, rays, groups, own, goal, inside, filter_):  # noqa: ARG001
    index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
    return _search_instance(packet, index, leaves, box, rays, groups, goal, inside, filter_)


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
        hits, lanes = _Hits(packet, g), GroupLanes(packet, g)
        hits.t = f32x16(_INF)
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
        hits.t = World(worlds, g).best_t


@device
def _finish(packet):
    """Make the distances of all groups those that are reported."""
    for g in range(GROUPS):
        group = Group(packet, g)
        group.t, group.t_scale = _Hits(packet, g).t + _ZERO, f32x16(_ONE)
        set_slow(group)


@kernel
def trace_instance_packets(begin, end, top, source, wants_any, filter_, out):
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
        mine = packet_filter(filter_, source.order, number, _ALL_GROUPS)
        most = padded.frame.max_coordinate
        _trace_scene(packet, GROUPS, tree, most, memory, goal, inside, mine)
        _finish(packet)
        store_packet(packet, number, source.order, slow_groups, wants_any, out)
