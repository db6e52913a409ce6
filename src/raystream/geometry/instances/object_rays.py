"""Groups of 16 rays in the space of an instance's object, loaded from the rays of a scene.

The numbers are those that `kernels.ray_source.local_ray` gives for a single ray, 16 at a time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import VALID
from raystream.geometry.instances.merged_hits import Merged, MergedLanes, ray_index
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord
from raystream.jit.constants import INF_F32, INF_F64, ONE_U64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    any_lane,
    bits_as_float,
    f32x16,
    f64x16,
    load,
    mask_bits,
    popcount,
    scratch,
    select,
    store,
    widen,
)
from raystream.jit.views import address_of, view
from raystream.kernels.best import far_limits
from raystream.kernels.box_entry import advanced, box_entry, outside_by
from raystream.kernels.ray import (
    FAR,
    LocalRay,
    WorldRay,
    largest,
    local_limit,
    rounded,
    scaled,
    to_frame,
)
from raystream.kernels.ray_source import in_object, local_ray, read_ray, scale_ray
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packets.load import lanes_loader, prepare_group
from raystream.structures.bvh.packets.rays import (
    NO_PRIM,
    Group,
    GroupLanes,
    put_local,
    put_local_of_lane,
    put_three_of_lane,
    three,
    three_of_lane,
)
from raystream.structures.bvh.ray_groups.rays import (
    GROUP_SHIFT,
    LANE_SHIFT,
    LAST_LANE,
    LISTS_AT,
    arrange_group,
)

_LANES = np.uint64(16)
_ALL = np.uint64(0xFFFF)

#: Origins beyond this are left to the function for single rays, which tells valid ones.
_MAX_ORIGIN = np.float64(2.0**100)

#: An advanced origin that was further away than this many of the object's largest coordinates is
#: left to the function for single rays: nearer ones are exact to a small part of the object's box.
_MAX_STEPS = np.float64(2.0**30)

#: Numbers of 16 rays in world space, and of their best hits so far.
WORLD = [
    ("origin", "f8", (3, 16)),
    ("direction", "f8", (3, 16)),
    ("t_min", "f4", (16,)),
    ("best_t", "f4", (16,)),
    ("best", "i4", (16,)),
    ("unused", "f4", (16,)),
]
WORLD_BYTES = np.dtype(WORLD).itemsize
World = view(WORLD)
WorldLanes = view([(name, kind, (*shape, 1)) for name, kind, shape in WORLD])


@device
def read_into(world, lane, source, i):
    """Read ray i, without a hit."""
    ray = read_ray(source, i)
    put_three_of_lane(world.origin, lane, ray.origin)
    put_three_of_lane(world.direction, lane, ray.direction)
    world.t_min[lane], world.best_t[lane] = ray.t_min, ray.t_max


@device
def _read_rays(world, rays, first, last, scene, source):
    """Read 16 rays of a list from `first` on; the last one is repeated."""
    for lane in range(_LANES):
        number = np.uint64(load(np.uint32, rays + min(first + lane, last) * LANE))
        lanes, k = MergedLanes(scene, number >> LANE_SHIFT), number & LAST_LANE
        read_into(world, lane, source, ray_index(scene, number))
        world.best[lane] = lanes.prim_id[k]
        if lanes.prim_id[k] != NO_PRIM:
            world.best_t[lane] = lanes.t[k]


class _Placed(NamedTuple):
    """Sixteen rays in world space, and the object in whose space they are searched.

    Attributes
    ----------
    world : uint64
        Address of a `World`.
    instance : InstanceRecord
    frame : ObjectRecord
    """

    world: np.uint64
    instance: Any
    frame: Any


@device
def _read(source, first):  # noqa: ARG001
    # The products of a single ray, in the same order, so that the bits are the same.
    world = World(source.world)
    origin, direction = three(world.origin), three(world.direction)
    return in_object(WorldRay(origin, direction, world.t_min, world.best_t), source.instance)


@device
def _chosen(chosen, a, b):
    """The lanes of mask a where `chosen` is set, else of mask b."""
    return (chosen & a) | (~chosen & b)


@device
def _chosen_three(chosen, a, b):
    return select(chosen, a[0], b[0]), select(chosen, a[1], b[1]), select(chosen, a[2], b[2])


@device
def _move(ray, source):
    """Move 16 rays from object space into the local frame; see `kernels.ray.to_local`."""
    frame, has_hit = source.frame, World(source.world).best != NO_PRIM
    # Step 1: lengths in the local frame. Limits that are not exact there are left to `_load_one`,
    # except one that a hit has set: reported distances decide what is kept.
    is_usual, power, t_scale, low, high, is_exact = scale_ray(ray, frame)
    origin, direction = to_frame(ray.origin, frame), scaled(ray.direction, power)
    is_usual = is_usual & (largest(ray.origin) <= _MAX_ORIGIN)
    is_exact = is_exact[0] & (has_hit | is_exact[1])

    # Step 2: advance origins that are far outside. A second step corrects the rounding error of
    # the first; lines that miss the box take no further part.
    most = np.float64(frame.max_coordinate)
    advances = is_usual & (outside_by(origin, frame) > FAR * most)
    t_offset = f64x16(ZERO_F64)
    if any_lane(advances):
        first = box_entry(origin, direction, frame)
        there = advanced(origin, direction, first)
        second = box_entry(there, direction, frame)
        there = advanced(there, direction, second)
        total = first + second
        missed = (first == INF_F64) | (second == INF_F64)
        offset = total * t_scale
        # A box behind the origin is not met, and a start of the interval before the box does not
        # matter.
        near_by = absolute(total) <= _MAX_STEPS * most
        is_behind = near_by & (total < ZERO_F64) & (widen(ray.t_min) >= ZERO_F64)
        begins_before = near_by & (offset >= widen(ray.t_min))
        is_exact = _chosen(advances, missed | is_behind | begins_before, is_exact)
        missed = (missed | is_behind) & advances
        zero = f64x16(ZERO_F64)  # there is no NaN in a group
        there = _chosen_three(missed, (zero, zero, zero), there)
        origin = _chosen_three(advances, there, origin)
        t_offset = select(advances, select(missed, zero, offset), t_offset)
        low = select(advances, select(missed, f32x16(INF_F32), f32x16(-INF_F32)), low)
    # A limit that lies too far is harmless, one that is too near is not.
    high = select(has_hit | advances, far_limits(ray.t_max, t_scale, t_offset), high)
    high = select(low == INF_F32, f32x16(-INF_F32), high)
    local = LocalRay(rounded(origin), rounded(direction), low, high, t_scale, t_offset, VALID)
    return is_usual & is_exact, local


@device
def _put(at, local, is_so):  # noqa: ARG001
    group = Group(at)
    put_local(group, local)
    group.slow_t_scale, group.slow_t_offset = local.t_scale, local.t_offset


@device_call
def _load_one(at, lane, source, i, is_traced):  # noqa: ARG001
    """Load a ray with unusual numbers, by the function for single rays."""
    no_inline()
    world, lanes = WorldLanes(source.world), GroupLanes(at)
    origin, direction = three_of_lane(world.origin, lane), three_of_lane(world.direction, lane)
    best_t = world.best_t[lane]
    whole = WorldRay(origin, direction, world.t_min[lane], best_t)
    ray = local_ray(whole, source.frame, source.instance)
    put_local_of_lane(lanes, lane, ray)
    if world.best[lane] != NO_PRIM and ray.t_min <= ray.t_max:
        lanes.t[lane] = local_limit(best_t, ray.t_scale, ray.t_offset)


_load_lanes = lanes_loader(_read, _move, _put, _load_one)


@device
def load_in_object(at, world, instance, object_):
    """Load 16 rays in object space as the group at an address; `world` is that of a `World`."""
    _load_lanes(at, _Placed(world, instance, object_), ZERO_U64, _LANES)


@device
def load_rays(scene, inside, rays, count, source, leaves, index, objects):
    """Load rays of a scene as groups in the space of an instance's object.

    Parameters
    ----------
    scene, inside : uint64
        Memory of the groups of the scene, and of these.
    rays : uint64
        Address of the numbers of the rays in the scene.
    count : uint64
        At least 1.
    source : RaySource
    leaves, index, objects : uint64
        See `TopAddresses`.

    Returns
    -------
    group_count, ray_count : uint64
        Groups in the list at ``inside + LISTS_AT``, and their rays: those that may hit the object.
    """
    instance = InstanceRecord(leaves, index)
    object_ = ObjectRecord(objects, np.uint64(instance.object_id))
    at = scratch(WORLD_BYTES)
    own, world = WorldLanes(at), World(at)
    groups, group_count, ray_count = inside + LISTS_AT, ZERO_U64, ZERO_U64
    first, last = ZERO_U64, count - ONE_U64
    while first < count:
        g = first >> LANE_SHIFT
        _read_rays(own, rays, first, last, scene, source)
        group, hits = Group(inside, g), Merged(inside, g)
        load_in_object(address_of(group), at, instance, object_)
        prepare_group(group, object_.max_coordinate)
        hits.t, hits.prim_id, hits.before = world.best_t, world.best, bits_as_float(world.best)
        arrange_group(group, inside, first)
        bits = mask_bits(group.t_min <= group.t)
        bits &= _ALL >> (_LANES - min(count - first, _LANES))
        store(groups + group_count * LANE, np.uint32((g << GROUP_SHIFT) | bits))
        group_count += np.uint64(bits != ZERO_U64)
        ray_count += popcount(bits)
        first += _LANES
    return group_count, ray_count
