"""Groups of 16 rays in object space: loaded from the rays of a scene, and their hits.

The numbers are those that `kernels.ray_source.local_ray` gives for a single ray, 16 at a time.
Hits are kept as `kernels.search.offer` keeps them: by their t as it is reported, then prim_id.
"""

from __future__ import annotations

import numpy as np

from raystream.instances.records import InstanceRecord, ObjectRecord
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    any_lane,
    bits_as_float,
    count_trailing_zeros,
    f32x16,
    f64x16,
    float_as_bits,
    i32x16,
    i64x16,
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
from raystream.kernels.ray import (
    FAR,
    LEAST_EXPONENT,
    MANTISSA_BITS,
    MOST_EXPONENT,
    POWER_EXPONENT,
    local_limit,
    world_t,
)
from raystream.kernels.ray_source import load_direction, load_limits, load_origin, local_ray
from raystream.structures.bvh.group_leaf import leaf_tests
from raystream.structures.bvh.group_rays import (
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LAST_LANE,
    LISTS_AT,
    PLACES_AT,
    Hot,
    arrange_group,
)
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packet_load import prepare_group
from raystream.structures.bvh.packet_rays import (
    GROUP,
    NO_PRIM,
    Group,
    GroupPlaces,
    first_ray,
    three,
)

__all__ = ["MERGED", "OBJECT_TESTS", "MergedGroup", "MergedLanes", "keep_hits", "load_rays"]

_U0, _U1 = np.uint64(0), np.uint64(1)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_LANES = np.uint64(16)
_ALL = np.uint64(0xFFFF)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_INF64, _ZERO64 = np.float64(np.inf), np.float64(0.0)
_LARGEST = np.float32(np.finfo(np.float32).max)
_FOUND = np.int32(1)

#: Origins beyond this are left to the function for single rays, which tells valid ones.
_MAX_ORIGIN = np.float64(2.0**100)

#: An advanced origin that was further away than this many of the object's largest coordinates is
#: left to the function for single rays: nearer ones are exact to a small part of the object's box.
_MAX_STEPS = np.float64(2.0**30)

#: A group of `packet_rays`, whose fields for other kernels have the hits that are merged from
#: several instances: t as it is reported, the number of the triangle, and whether there is one
#: from this instance.
_NAMES = {
    "t_active": ("best_t", "f4"),
    "t_scale": ("found", "i4"),
    "slow_t_scale": ("t_scale", "f8"),
    "slow_t_offset": ("t_offset", "f8"),
}


def _merged(is_indexed: bool) -> np.dtype:
    fields = []
    for name in GROUP.names or ():
        base, shape = GROUP[name].subdtype or (GROUP[name], ())
        name_, kind = _NAMES.get(name, (name, base.str))
        fields.append((name_, kind, (*shape, 1) if is_indexed else shape))
    return np.dtype(fields)


MERGED = _merged(False)
MergedGroup = view(MERGED)
#: The same with a lane index.
MergedLanes = view(_merged(True))

#: Numbers of 16 rays in world space, and of their best hits so far.
_WORLD = [
    ("origin", "f8", (3, 16)),
    ("direction", "f8", (3, 16)),
    ("t_min", "f4", (16,)),
    ("best_t", "f4", (16,)),
    ("best", "i4", (16,)),
    ("unused", "f4", (16,)),
]
_WORLD_BYTES = np.dtype(_WORLD).itemsize
_World = view(_WORLD)
_WorldLanes = view([(name, kind, (*shape, 1)) for name, kind, shape in _WORLD])


# Hits


@device
def _limits(best_t, t_scale, t_offset):
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
def _keep_in_group(memory, g, taken, t, u, v, prim_id, wants_any, filter_):  # noqa: ARG001
    group = MergedGroup(memory, g)
    t_scale, t_offset = group.t_scale, group.t_offset
    world = _reported(t, t_scale, t_offset)
    best_t, best, prim_ids = group.best_t, group.prim_id, i32x16(prim_id)
    taken = taken & ((world < best_t) | ((world == best_t) & (prim_ids < best)))
    bits = mask_bits(taken)
    if bits == _U0:
        return False
    nearest = group.t
    far = f32x16(-_INF) if wants_any else minimum(_limits(world, t_scale, t_offset), nearest)
    group.t = select(taken, far, nearest)
    group.best_t, group.prim_id = select(taken, world, best_t), select(taken, prim_ids, best)
    group.u, group.v = select(taken, u, group.u), select(taken, v, group.v)
    group.found = select(taken, i32x16(_FOUND), group.found)
    lanes = MergedLanes(memory, g)
    while bits != _U0:
        k = count_trailing_zeros(bits)
        bits &= bits - _U1
        Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = lanes.t[k]
    return True


@device
def _keep_of_ray(memory, number, block, bits, found, wants_any, filter_):  # noqa: ARG001
    g, k = number >> LANE_SHIFT, number & LAST_LANE
    lanes, hot, prim_ids = MergedLanes(memory, g), Hot(memory + HOT_AT, number), block.prim_ids
    best_t, best = lanes.best_t[k], lanes.prim_id[k]
    t_scale, t_offset = lanes.t_scale[k], lanes.t_offset[k]
    has_hit = False
    while bits != _U0:
        lane = count_trailing_zeros(bits)
        bits &= bits - _U1
        t, prim_id = world_t(found.t[lane], t_scale, t_offset), prim_ids[lane]
        if t < best_t or (t == best_t and prim_id < best):
            best_t, best, has_hit = t, prim_id, True
            lanes.u[k], lanes.v[k] = found.u[lane], found.v[lane]
    if has_hit:
        far = -_INF if wants_any else min(local_limit(best_t, t_scale, t_offset), lanes.t[k])
        lanes.best_t[k], lanes.prim_id[k], lanes.found[k] = best_t, best, _FOUND
        lanes.t[k], hot.t = far, far


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
    hit_count = _U0
    for g in range((count + LAST_LANE) >> LANE_SHIFT):
        bits = mask_bits(MergedGroup(inside, g).found != np.int32(0))
        lanes = MergedLanes(inside, g)
        while bits != _U0:
            k = count_trailing_zeros(bits)
            bits &= bits - _U1
            at = (g << LANE_SHIFT) | k
            if at >= count:  # a copy of the last ray
                break
            hit_count += _U1
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


# Rays


@device
def _read_rays(world, rays, first, last, scene, source, first_id):
    """Read 16 rays of a list from `first` on; the last one is repeated."""
    places = GroupPlaces(scene + PLACES_AT, _U0, _U0)
    origin, direction = world.origin, world.direction
    for lane in range(_LANES):
        number = np.uint64(load(np.uint32, rays + min(first + lane, last) * LANE))
        g, k = number >> LANE_SHIFT, number & LAST_LANE
        i = first_ray(places, g) + k
        origin[_X, lane], origin[_Y, lane], origin[_Z, lane] = load_origin(source, i)
        direction[_X, lane], direction[_Y, lane], direction[_Z, lane] = load_direction(source, i)
        t_min, t_max = load_limits(source, i)
        lanes = MergedLanes(scene, g)
        best_t, best = t_max, lanes.prim_id[k]
        if best != NO_PRIM:
            best_t, best = lanes.best_t[k], np.int32(best - first_id)
        world.t_min[lane], world.best_t[lane], world.best[lane] = t_min, best_t, best


@device
def _product(row, x, y, z):
    return x * row[0] + y * row[1] + z * row[2]


@device
def _crossing(o, d, low, high, margin):
    """Intervals of lines between two planes that a margin moves apart; see `kernels.ray`."""
    to_low = (np.float64(low) - margin) - o
    to_high = (np.float64(high) + margin) - o
    t_low, t_high = to_low / d, to_high / d
    is_flat = d == _ZERO64
    beside = is_flat & ((to_low > _ZERO64) | (to_high < _ZERO64))
    t_in = select(is_flat, f64x16(-_INF64), minimum(t_low, t_high))
    t_out = select(is_flat, f64x16(_INF64), maximum(t_low, t_high))
    return select(beside, f64x16(_INF64), t_in), select(beside, f64x16(-_INF64), t_out)


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
    return select(t_in <= t_out, t_in, f64x16(_INF64))


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
    lanes.t_scale[lane], lanes.t_offset[lane] = ray.t_scale, ray.t_offset


@device
def _load_group(group, world, instance, object_):
    """Load 16 rays in object space; see `kernels.ray.to_local`."""
    ax, ay, az = instance.linear[_X], instance.linear[_Y], instance.linear[_Z]
    shift, center, scale = instance.shift, object_.center, object_.scale
    x, y, z = three(world.origin)
    dx, dy, dz = three(world.direction)
    wx = _product(ax, x, y, z) + shift[0]
    wy = _product(ay, x, y, z) + shift[1]
    wz = _product(az, x, y, z) + shift[2]
    dx, dy, dz = _product(ax, dx, dy, dz), _product(ay, dx, dy, dz), _product(az, dx, dy, dz)
    ox, oy, oz = (wx - center[0]) * scale, (wy - center[1]) * scale, (wz - center[2]) * scale

    largest = maximum(maximum(absolute(dx), absolute(dy)), absolute(dz))
    exponent = float_as_bits(largest) >> MANTISSA_BITS
    power = bits_as_float((i64x16(POWER_EXPONENT) - exponent) << MANTISSA_BITS)
    inverse = bits_as_float(exponent << MANTISSA_BITS) * scale
    t_scale = power * object_.inverse_scale
    dx, dy, dz = dx * power, dy * power, dz * power
    reach = maximum(maximum(absolute(wx), absolute(wy)), absolute(wz))
    is_usual = (
        (exponent >= LEAST_EXPONENT)
        & (exponent <= MOST_EXPONENT)
        & (absolute(dx) + absolute(dy) + absolute(dz) < _INF64)
        & (reach <= _MAX_ORIGIN)
    )

    # Limits of rays that are not advanced: exact, or left to `_load_singly`.
    t_min, best_t = world.t_min, world.best_t
    low = narrow(widen(t_min) * inverse) + _ZERO
    high = narrow(widen(best_t) * inverse) + _ZERO
    has_hit = world.best != NO_PRIM
    is_exact = widen(low) * t_scale == widen(t_min)
    is_exact = is_exact & (has_hit | (widen(high) * t_scale == widen(best_t)))

    # Origins that are far outside are advanced.
    box_low, box_high = object_.low, object_.high
    far = FAR * np.float64(object_.max_coordinate)
    outside = maximum(
        maximum(
            _outside_by(ox, box_low[0], box_high[0]), _outside_by(oy, box_low[1], box_high[1])
        ),
        _outside_by(oz, box_low[2], box_high[2]),
    )
    advanced = is_usual & (outside > far)
    t_offset = f64x16(_ZERO64)
    if any_lane(advanced):
        direction = dx, dy, dz
        first = _entry((ox, oy, oz), direction, object_)
        px, py, pz = ox + first * dx, oy + first * dy, oz + first * dz
        second = _entry((px, py, pz), direction, object_)
        px, py, pz = px + second * dx, py + second * dy, pz + second * dz
        total = first + second
        missed = (first == _INF64) | (second == _INF64)
        offset = total * t_scale
        # A box behind the origin is not met, and a start of the interval before the box does not
        # matter.
        near_by = absolute(total) <= _MAX_STEPS * np.float64(object_.max_coordinate)
        is_behind = near_by & (total < _ZERO64) & (widen(t_min) >= _ZERO64)
        begins_before = near_by & (offset >= widen(t_min))
        is_exact = _chosen(advanced, missed | is_behind | begins_before, is_exact)
        missed = missed | is_behind
        ox, oy, oz = select(advanced, px, ox), select(advanced, py, oy), select(advanced, pz, oz)
        t_offset = select(advanced, offset, t_offset)
        low = select(advanced, f32x16(-_INF), low)
        missed = missed & advanced
        zero = f64x16(_ZERO64)  # there is no NaN in a group
        ox, oy, oz = select(missed, zero, ox), select(missed, zero, oy), select(missed, zero, oz)
        t_offset = select(missed, zero, t_offset)
        low = select(missed, f32x16(_INF), low)
    high = select(has_hit | advanced, _limits(best_t, t_scale, t_offset), high)
    high = select(low == _INF, f32x16(-_INF), high)

    origin, to = group.origin, group.direction
    origin[_X], origin[_Y], origin[_Z] = narrow(ox), narrow(oy), narrow(oz)
    to[_X], to[_Y], to[_Z] = narrow(dx), narrow(dy), narrow(dz)
    group.t_min, group.t = low, high
    group.t_scale, group.t_offset = t_scale, t_offset
    bits = mask_bits(is_usual & is_exact) ^ _ALL
    lanes = MergedLanes(address_of(group))
    own = _WorldLanes(address_of(world))
    while bits != _U0:
        lane = count_trailing_zeros(bits)
        bits &= bits - _U1
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
    at = scratch(_WORLD_BYTES)
    own, world = _WorldLanes(at), _World(at)
    groups, group_count, ray_count = inside + LISTS_AT, _U0, _U0
    first, last = _U0, count - _U1
    while first < count:
        g = first >> LANE_SHIFT
        _read_rays(own, rays, first, last, scene, source, instance.first_id)
        group = MergedGroup(inside, g)
        _load_group(group, world, instance, object_)
        prepare_group(Group(inside, g), object_.max_coordinate)
        group.best_t, group.prim_id, group.found = world.best_t, world.best, i32x16(np.int32(0))
        arrange_group(Group(inside, g), inside, first)
        bits = mask_bits(group.t_min <= group.t)
        bits &= _ALL >> (_LANES - min(count - first, _LANES))
        store(groups + group_count * LANE, np.uint32((g << GROUP_SHIFT) | bits))
        group_count += np.uint64(bits != _U0)
        ray_count += popcount(bits)
        first += _LANES
    return group_count, ray_count
