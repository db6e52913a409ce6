"""Groups of 16 rays in the space of an instance's object, loaded from the rays of a scene.

The numbers are those that `kernels.ray_source.local_ray` gives for a single ray, 16 at a time.
"""

from __future__ import annotations

import numpy as np

from raystream.geometry.instances.merged_hits import Merged, MergedLanes, ray_index
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord
from raystream.jit.constants import INF_F32, INF_F64, ONE_U64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    any_lane,
    bits_as_float,
    count_trailing_zeros,
    f32x16,
    f64x16,
    load,
    mask_bits,
    maximum,
    minimum,
    narrow,
    popcount,
    scratch,
    select,
    store,
    widen,
)
from raystream.jit.views import address_of, view
from raystream.kernels.best import far_limits
from raystream.kernels.ray import (
    FAR,
    local_limit,
)
from raystream.kernels.ray_source import load_direction, load_limits, load_origin, local_ray
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packets.load import prepare_group, scale_lanes
from raystream.structures.bvh.packets.rays import NO_PRIM, Group, GroupLanes, three
from raystream.structures.bvh.ray_groups.rays import (
    GROUP_SHIFT,
    LANE_SHIFT,
    LAST_LANE,
    LISTS_AT,
    arrange_group,
)

_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
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
def read_ray(world, lane, source, i):
    """Read ray i, without a hit."""
    origin, direction = world.origin, world.direction
    origin[_X, lane], origin[_Y, lane], origin[_Z, lane] = load_origin(source, i)
    direction[_X, lane], direction[_Y, lane], direction[_Z, lane] = load_direction(source, i)
    world.t_min[lane], world.best_t[lane] = load_limits(source, i)


@device
def _read_rays(world, rays, first, last, scene, source):
    """Read 16 rays of a list from `first` on; the last one is repeated."""
    for lane in range(_LANES):
        number = np.uint64(load(np.uint32, rays + min(first + lane, last) * LANE))
        lanes, k = MergedLanes(scene, number >> LANE_SHIFT), number & LAST_LANE
        read_ray(world, lane, source, ray_index(scene, number))
        world.best[lane] = lanes.prim_id[k]
        if lanes.prim_id[k] != NO_PRIM:
            world.best_t[lane] = lanes.t[k]


@device
def _product(row, x, y, z):
    return x * row[0] + y * row[1] + z * row[2]


@device
def _crossing(o, d, low, high, margin):
    """Intervals of lines between two planes that a margin moves apart; see `kernels.ray`."""
    to_low = (np.float64(low) - margin) - o
    to_high = (np.float64(high) + margin) - o
    t_low, t_high = to_low / d, to_high / d
    is_flat = d == ZERO_F64
    beside = is_flat & ((to_low > ZERO_F64) | (to_high < ZERO_F64))
    t_in = select(is_flat, f64x16(-INF_F64), minimum(t_low, t_high))
    t_out = select(is_flat, f64x16(INF_F64), maximum(t_low, t_high))
    return select(beside, f64x16(INF_F64), t_in), select(beside, f64x16(-INF_F64), t_out)


@device
def _entry(origin, direction, frame):
    """Distances at which lines enter a box, padded by its size; inf for a miss."""
    margin = np.float64(frame.max_coordinate)
    low, high = frame.low, frame.high
    in_x, out_x = _crossing(origin[0], direction[0], low[0], high[0], margin)
    in_y, out_y = _crossing(origin[1], direction[1], low[1], high[1], margin)
    in_z, out_z = _crossing(origin[2], direction[2], low[2], high[2], margin)
    t_in = maximum(maximum(in_x, in_y), in_z)
    t_out = minimum(minimum(out_x, out_y), out_z)
    return select(t_in <= t_out, t_in, f64x16(INF_F64))


@device
def _outside_by(o, low, high):
    return maximum(np.float64(low) - o, o - np.float64(high))


@device_call
def _load_singly(lanes, lane, world, instance, object_):
    """Load a ray by the function for single rays."""
    no_inline()
    ax, ay, az = instance.linear[_X], instance.linear[_Y], instance.linear[_Z]
    shift = instance.shift
    origin, direction = world.origin, world.direction
    x, y, z = origin[_X, lane], origin[_Y, lane], origin[_Z, lane]
    dx, dy, dz = direction[_X, lane], direction[_Y, lane], direction[_Z, lane]
    ray = local_ray(
        ax[0] * x + ax[1] * y + ax[2] * z + shift[0],
        ay[0] * x + ay[1] * y + ay[2] * z + shift[1],
        az[0] * x + az[1] * y + az[2] * z + shift[2],
        ax[0] * dx + ax[1] * dy + ax[2] * dz,
        ay[0] * dx + ay[1] * dy + ay[2] * dz,
        az[0] * dx + az[1] * dy + az[2] * dz,
        world.t_min[lane],
        world.best_t[lane],
        object_,
    )
    lanes.origin[_X, lane], lanes.origin[_Y, lane], lanes.origin[_Z, lane] = ray.ox, ray.oy, ray.oz
    to = lanes.direction
    to[_X, lane], to[_Y, lane], to[_Z, lane] = ray.dx, ray.dy, ray.dz
    far = ray.t_max
    if world.best[lane] != NO_PRIM and ray.t_min <= far:
        far = local_limit(world.best_t[lane], ray.t_scale, ray.t_offset)
    lanes.t_min[lane], lanes.t[lane] = ray.t_min, far
    lanes.slow_t_scale[lane], lanes.slow_t_offset[lane] = ray.t_scale, ray.t_offset


@device
def load_in_object_space(group, world, instance, object_):
    """Load 16 rays in object space; see `kernels.ray.to_local`."""
    ax, ay, az = instance.linear[_X], instance.linear[_Y], instance.linear[_Z]
    shift, center, scale = instance.shift, object_.center, object_.scale
    # Step 1: the products of a single ray, in the same order, so that the bits are the same.
    x, y, z = three(world.origin)
    dx, dy, dz = three(world.direction)
    wx = _product(ax, x, y, z) + shift[0]
    wy = _product(ay, x, y, z) + shift[1]
    wz = _product(az, x, y, z) + shift[2]
    dx, dy, dz = _product(ax, dx, dy, dz), _product(ay, dx, dy, dz), _product(az, dx, dy, dz)
    ox, oy, oz = (wx - center[0]) * scale, (wy - center[1]) * scale, (wz - center[2]) * scale

    # Step 2: lengths in the local frame. Limits that are not exact there are left to
    # `_load_singly`, except one that a hit has set: reported distances decide what is kept.
    t_min, best_t = world.t_min, world.best_t
    is_usual, power, t_scale, low, high = scale_lanes((dx, dy, dz), t_min, best_t, object_)
    dx, dy, dz = dx * power, dy * power, dz * power
    reach = maximum(maximum(absolute(wx), absolute(wy)), absolute(wz))
    is_usual = is_usual & (reach <= _MAX_ORIGIN)
    has_hit = world.best != NO_PRIM
    is_exact = widen(low) * t_scale == widen(t_min)
    is_exact = is_exact & (has_hit | (widen(high) * t_scale == widen(best_t)))

    # Step 3: advance origins that are far outside. A second step corrects the rounding error of
    # the first; lines that miss the box take no further part.
    box_low, box_high = object_.low, object_.high
    far = FAR * np.float64(object_.max_coordinate)
    outside = maximum(
        maximum(_outside_by(ox, box_low[0], box_high[0]), _outside_by(oy, box_low[1], box_high[1])),
        _outside_by(oz, box_low[2], box_high[2]),
    )
    advanced = is_usual & (outside > far)
    t_offset = f64x16(ZERO_F64)
    if any_lane(advanced):
        direction = dx, dy, dz
        first = _entry((ox, oy, oz), direction, object_)
        px, py, pz = ox + first * dx, oy + first * dy, oz + first * dz
        second = _entry((px, py, pz), direction, object_)
        px, py, pz = px + second * dx, py + second * dy, pz + second * dz
        total = first + second
        missed = (first == INF_F64) | (second == INF_F64)
        offset = total * t_scale
        # A box behind the origin is not met, and a start of the interval before the box does not
        # matter.
        near_by = absolute(total) <= _MAX_STEPS * np.float64(object_.max_coordinate)
        is_behind = near_by & (total < ZERO_F64) & (widen(t_min) >= ZERO_F64)
        begins_before = near_by & (offset >= widen(t_min))
        is_exact = _chosen(advanced, missed | is_behind | begins_before, is_exact)
        missed = missed | is_behind
        ox, oy, oz = select(advanced, px, ox), select(advanced, py, oy), select(advanced, pz, oz)
        t_offset = select(advanced, offset, t_offset)
        low = select(advanced, f32x16(-INF_F32), low)
        missed = missed & advanced
        zero = f64x16(ZERO_F64)  # there is no NaN in a group
        ox, oy, oz = select(missed, zero, ox), select(missed, zero, oy), select(missed, zero, oz)
        t_offset = select(missed, zero, t_offset)
        low = select(missed, f32x16(INF_F32), low)
    # A limit that lies too far is harmless, one that is too near is not.
    high = select(has_hit | advanced, far_limits(best_t, t_scale, t_offset), high)
    high = select(low == INF_F32, f32x16(-INF_F32), high)

    origin, to = group.origin, group.direction
    origin[_X], origin[_Y], origin[_Z] = narrow(ox), narrow(oy), narrow(oz)
    to[_X], to[_Y], to[_Z] = narrow(dx), narrow(dy), narrow(dz)
    group.t_min, group.t = low, high
    group.slow_t_scale, group.slow_t_offset = t_scale, t_offset
    # Step 4: lanes with unusual numbers, one by one.
    bits = mask_bits(is_usual & is_exact) ^ _ALL
    lanes = GroupLanes(address_of(group))
    own = WorldLanes(address_of(world))
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        _load_singly(lanes, lane, own, instance, object_)


@device
def _chosen(chosen, a, b):
    """The lanes of mask a where `chosen` is set, else of mask b."""
    return (chosen & a) | (~chosen & b)


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
        load_in_object_space(group, world, instance, object_)
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
