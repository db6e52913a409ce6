"""Hits of groups of 16 rays, merged from several instances.

They are kept as `kernels.search.offer` keeps them: by their t as it is reported, then by the number
of the triangle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    any_lane,
    count_trailing_zeros,
    f32x16,
    i32x16,
    load,
    mask_bits,
    maximum,
    minimum,
    narrow,
    select,
    widen,
)
from raystream.jit.views import address_of, view
from raystream.kernels.ray import local_limit, world_t
from raystream.kernels.search import is_before
from raystream.structures.bvh.group_leaf import leaf_tests
from raystream.structures.bvh.group_rays import HOT_AT, LANE_SHIFT, LAST_LANE, Hot
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packet_leaf import ANY, leaf_visit
from raystream.structures.bvh.packet_rays import GROUP, NO_PRIM

_INF = np.float32(np.inf)
_LARGEST = np.float32(np.finfo(np.float32).max)
_FOUND = np.int32(1)


#: A group of `packet_rays`, whose fields for other kernels have the hits that are merged from
#: several instances: t as it is reported, the number of the triangle, and whether there is one
#: from this instance.
_NAMES = {
    "t_active": ("best_t", "f4"),
    "t_scale": ("found", "i4"),
    "slow_t_scale": ("t_scale", "f8"),
    "slow_t_offset": ("t_offset", "f8"),
}


#: The same for a group of a packet, whose `t_active` is its own.
_PACKET_NAMES = {
    "t_scale": ("best_t", "f4"),
    "slow_t_scale": ("t_scale", "f8"),
    "slow_t_offset": ("t_offset", "f8"),
}


def _merged(is_indexed: bool, names: Mapping[str, tuple[str, str]] = _NAMES) -> np.dtype:
    fields = []
    for name in GROUP.names or ():
        base, shape = GROUP[name].subdtype or (GROUP[name], ())
        name_, kind = names.get(name, (name, base.str))
        fields.append((name_, kind, (*shape, 1) if is_indexed else shape))
    return np.dtype(fields)


MERGED = _merged(False)
MergedGroup = view(MERGED)
#: The same with a lane index.
MergedLanes = view(_merged(True))
PacketGroup = view(_merged(False, _PACKET_NAMES))
_PacketLanes = view(_merged(True, _PACKET_NAMES))


@device
def far_limits(best_t, t_scale, t_offset):
    """Distances in object space beyond which all are reported as more than `best_t`.

    Not the least ones, as of `kernels.ray.local_limit`: what is kept is decided by reported
    distances.
    """
    t = widen(best_t)
    slack = absolute(t) * 2.0**-22 + absolute(t_offset) * 2.0**-48 + 2.0**-147
    near = narrow((t + slack - t_offset) / t_scale)
    far = near + absolute(near) * np.float32(2.0**-22) + np.float32(2.0**-140)
    return select(best_t >= _LARGEST, f32x16(_INF), far)


@device
def _reported(t, t_scale, t_offset):
    """Distances as they are reported; see `kernels.ray.world_t`."""
    world = narrow(widen(t) * t_scale + t_offset)
    return minimum(maximum(world, f32x16(-_LARGEST)), f32x16(_LARGEST))


@device
def _are_nearer(t, prim_ids, best_t, best):
    return (t < best_t) | ((t == best_t) & (prim_ids < best))


@device
def _keep_in_group(memory, g, taken, t, u, v, prim_id, wants_any, filter_):  # noqa: ARG001
    group = MergedGroup(memory, g)
    t_scale, t_offset = group.t_scale, group.t_offset
    world = _reported(t, t_scale, t_offset)
    best_t, best, prim_ids = group.best_t, group.prim_id, i32x16(prim_id)
    taken = taken & _are_nearer(world, prim_ids, best_t, best)
    bits = mask_bits(taken)
    if bits == ZERO_U64:
        return False
    nearest = group.t
    far = f32x16(-_INF) if wants_any else minimum(far_limits(world, t_scale, t_offset), nearest)
    group.t = select(taken, far, nearest)
    group.best_t, group.prim_id = select(taken, world, best_t), select(taken, prim_ids, best)
    group.u, group.v = select(taken, u, group.u), select(taken, v, group.v)
    group.found = select(taken, i32x16(_FOUND), group.found)
    lanes = MergedLanes(memory, g)
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = lanes.t[k]
    return True


@device
def _keep_of_ray(memory, number, block, bits, found, wants_any, filter_):  # noqa: ARG001
    g, k = number >> LANE_SHIFT, number & LAST_LANE
    lanes, hot, prim_ids = MergedLanes(memory, g), Hot(memory + HOT_AT, number), block.prim_ids
    best_t, best = lanes.best_t[k], lanes.prim_id[k]
    t_scale, t_offset = lanes.t_scale[k], lanes.t_offset[k]
    has_hit = False
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        t, prim_id = world_t(found.t[lane], t_scale, t_offset), prim_ids[lane]
        if is_before(t, prim_id, best_t, best):
            best_t, best, has_hit = t, prim_id, True
            lanes.u[k], lanes.v[k] = found.u[lane], found.v[lane]
    if has_hit:
        far = -_INF if wants_any else min(local_limit(best_t, t_scale, t_offset), lanes.t[k])
        lanes.best_t[k], lanes.prim_id[k], lanes.found[k] = best_t, best, _FOUND
        lanes.t[k], hot.t = far, far


@device
def _keep_in_packet(group, g, taken, t, uv, prim_id, goal, hits, filter_):  # noqa: ARG001
    own = PacketGroup(address_of(group))
    t_scale, t_offset = own.t_scale, own.t_offset
    world = _reported(t, t_scale, t_offset)
    best_t, best, prim_ids = own.best_t, own.prim_id, i32x16(prim_id)
    taken = taken & _are_nearer(world, prim_ids, best_t, best)
    if not any_lane(taken):
        return False
    own.prim_id = select(taken, prim_ids, best)
    nearest = own.t_active
    if goal == ANY:
        own.t_active = select(taken, f32x16(-_INF), nearest)
        return True
    far = minimum(far_limits(world, t_scale, t_offset), nearest)
    own.t_active, own.best_t = select(taken, far, nearest), select(taken, world, best_t)
    u, v = uv
    own.u, own.v = select(taken, u, own.u), select(taken, v, own.v)
    return True


@device
def _keep_of_packet_ray(lanes, k, hit, prim_ids, found, is_any, filter_):  # noqa: ARG001
    own = _PacketLanes(address_of(lanes))
    best_t, best, has_hit = own.best_t[k], own.prim_id[k], False
    t_scale, t_offset = own.t_scale[k], own.t_offset[k]
    while hit != ZERO_U64:
        lane = count_trailing_zeros(hit)
        hit &= hit - ONE_U64
        t, prim_id = world_t(found.t[lane], t_scale, t_offset), prim_ids[lane]
        if is_before(t, prim_id, best_t, best):
            best_t, best, has_hit = t, prim_id, True
            own.u[k], own.v[k] = found.u[lane], found.v[lane]
    if has_hit:
        far = -_INF if is_any else min(local_limit(best_t, t_scale, t_offset), own.t_active[k])
        own.best_t[k], own.prim_id[k], own.t_active[k] = best_t, best, far
    return has_hit


#: The visit of a leaf of an object by a packet.
visit_object_leaf = leaf_visit(_keep_in_packet, _keep_of_packet_ray)


@device
def numbers_within(prim_ids, first_id):
    """Numbers of triangles as those of an instance whose first one is given; `NO_PRIM` stays."""
    return select(prim_ids == NO_PRIM, prim_ids, prim_ids - first_id)


@device
def keep_packet_hits(group, inside, first_id, wants_any):
    """Merge the hits of 16 rays in an instance with those of the scene's group.

    Returns whether there is a new one.
    """
    prim_ids, best = inside.prim_id, group.prim_id
    found = prim_ids != numbers_within(best, first_id)
    if not any_lane(found):
        return False
    group.prim_id = select(found, prim_ids + first_id, best)
    nearest = group.t_active
    if wants_any:
        group.t_active = select(found, f32x16(-_INF), nearest)
        return True
    best_t = inside.best_t
    far = minimum(far_limits(best_t, group.t_scale, group.t_offset), nearest)
    group.t_active = select(found, far, nearest)
    group.best_t = select(found, best_t, group.best_t)
    group.u, group.v = select(found, inside.u, group.u), select(found, inside.v, group.v)
    return True


#: The tests of the leaves of objects.
OBJECT_TESTS = leaf_tests(_keep_in_group, _keep_of_ray)


@device
def keep_hits(scene, inside, rays, count, first_id, wants_any):
    """Merge the hits of an instance's rays with those of the scene's; returns their number.

    Parameters
    ----------
    scene, inside : uint64
        Memory of the groups in the scene and in the instance's object.
    rays : uint64
        Address of the numbers of these rays in the scene.
    count : uint64
    first_id : int32
        See `InstanceRay`.
    wants_any : bool
    """
    hit_count = ZERO_U64
    for g in range((count + LAST_LANE) >> LANE_SHIFT):
        bits = mask_bits(MergedGroup(inside, g).found != np.int32(0))
        lanes = MergedLanes(inside, g)
        while bits != ZERO_U64:
            k = count_trailing_zeros(bits)
            bits &= bits - ONE_U64
            at = (g << LANE_SHIFT) | k
            if at >= count:  # a copy of the last ray
                break
            hit_count += ONE_U64
            number = np.uint64(load(np.uint32, rays + at * LANE))
            to, own = MergedLanes(scene, number >> LANE_SHIFT), number & LAST_LANE
            hot = Hot(scene + HOT_AT, number)
            best_t, far = lanes.best_t[k], -_INF
            to.prim_id[own] = np.int32(lanes.prim_id[k] + first_id)
            if not wants_any:
                to.best_t[own], to.u[own], to.v[own] = best_t, lanes.u[k], lanes.v[k]
                far = min(local_limit(best_t, to.t_scale[own], to.t_offset[own]), to.t[own])
            to.t[own], hot.t = far, far
    return hit_count
