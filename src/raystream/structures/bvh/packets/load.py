"""Load a packet: 16 rays at a time, made local and prepared for the tests."""

from __future__ import annotations

import numpy as np

from raystream.core.rays import INVALID
from raystream.jit.constants import INF_F32, INF_F64, ONE_F32, ONE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    all_lanes,
    bits_as_float,
    copy_sign,
    count_trailing_zeros,
    f32x16,
    f64x16,
    float_as_bits,
    i32x16,
    i64x16,
    load,
    load_triples,
    mask_bits,
    maximum,
    narrow,
    prefetch,
    scratch,
    select,
    store,
    widen,
)
from raystream.jit.views import address_of
from raystream.kernels.ray import (
    LEAST_EXPONENT,
    MANTISSA_BITS,
    MOST_EXPONENT,
    PAD,
    POWER_EXPONENT,
    TINY_DIRECTION,
)
from raystream.kernels.ray_source import NEAR_REACH, load_ray
from raystream.structures.bvh.packets.rays import (
    GROUPS,
    NO_CLASS,
    NO_PRIM,
    Group,
    GroupLanes,
    group_rows,
    three,
)

_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_LANES = np.uint64(16)
_ALL_LANES = np.uint64(0xFFFF)
_LANE = np.uint64(4)
_WIDE = np.uint64(8)
_ROW, _WIDE_ROW = np.uint64(12), np.uint64(24)
_ROWS_BYTES = 16 * 24
_LINE = np.uint64(64)


@device
def _copy_rows(at, step, are_double, rows):
    """Copy 16 vectors that are `step` bytes apart to adjacent rows."""
    for _ in range(_LANES):
        if are_double:
            store(rows, load(np.float64, at))
            store(rows + _WIDE, load(np.float64, at + _WIDE))
            store(rows + (_WIDE + _WIDE), load(np.float64, at + (_WIDE + _WIDE)))
            rows += _WIDE_ROW
        else:
            store(rows, load(np.float32, at))
            store(rows + _LANE, load(np.float32, at + _LANE))
            store(rows + (_LANE + _LANE), load(np.float32, at + (_LANE + _LANE)))
            rows += _ROW
        at += step


@device
def _triples(base, step, are_double, first):
    """Three components of 16 rays, as float64 vectors."""
    at = base + first * step
    if step != ZERO_U64 and step != (_WIDE_ROW if are_double else _ROW):
        rows = scratch(_ROWS_BYTES)
        _copy_rows(at, step, are_double, rows)
        at = rows
    if are_double:
        if step == ZERO_U64:
            x = f64x16(load(np.float64, at))
            y = f64x16(load(np.float64, at + _WIDE))
            z = f64x16(load(np.float64, at + (_WIDE + _WIDE)))
        else:
            x, y, z = load_triples(f64x16, at)
    elif step == ZERO_U64:
        x = f64x16(np.float64(load(np.float32, at)))
        y = f64x16(np.float64(load(np.float32, at + _LANE)))
        z = f64x16(np.float64(load(np.float32, at + (_LANE + _LANE))))
    else:
        short_x, short_y, short_z = load_triples(f32x16, at)
        x, y, z = widen(short_x), widen(short_y), widen(short_z)
    return x, y, z


@device
def load_origins(source, first):
    """Origins of 16 consecutive rays, in float64, world space."""
    return _triples(source.origins, source.origin_step, source.origins_are_double, first)


@device
def load_directions(source, first):
    """Directions of 16 consecutive rays, in float64, world space."""
    return _triples(source.directions, source.direction_step, source.directions_are_double, first)


@device
def _numbers(base, step, first):
    at = base + first * step
    if step == np.uint64(0):
        return f32x16(load(np.float32, at))
    return load(f32x16, at)


@device_call
def _patch(lanes, lane, status, source, i, frame):
    """Load one ray into a lane of a group by the slow path."""
    no_inline()
    ray = load_ray(source, i, frame)
    origin, direction = lanes.origin, lanes.direction
    origin[_X, lane], origin[_Y, lane], origin[_Z, lane] = ray.ox, ray.oy, ray.oz
    direction[_X, lane], direction[_Y, lane], direction[_Z, lane] = ray.dx, ray.dy, ray.dz
    lanes.t_min[lane], lanes.t[lane] = ray.t_min, ray.t_max
    lanes.slow_t_scale[lane], lanes.slow_t_offset[lane] = ray.t_scale, ray.t_offset
    if ray.status == INVALID:
        store(status + i, INVALID)


@device
def scale_lanes(direction, t_min, t_max, frame):
    """Lengths of 16 rays in a local frame, see `ray_source.local_ray`.

    Returns
    -------
    is_usual : mask
        Rays whose directions one power of two scales.
    power : f64x16
        Of two: it scales the largest component of the direction to [1, 2).
    t_scale : f64x16
    low, high : f32x16
        The limits. They are exact if ``low * t_scale`` is t_min, and likewise for t_max.
    """
    dx, dy, dz = absolute(direction[0]), absolute(direction[1]), absolute(direction[2])
    exponent = float_as_bits(maximum(maximum(dx, dy), dz)) >> MANTISSA_BITS
    is_usual = (exponent >= LEAST_EXPONENT) & (exponent <= MOST_EXPONENT) & (dx + dy + dz < INF_F64)
    power = bits_as_float((i64x16(POWER_EXPONENT) - exponent) << MANTISSA_BITS)
    inverse = bits_as_float(exponent << MANTISSA_BITS) * frame.scale
    # Adding zero turns -0 into 0: the bits of positive numbers are in the numbers' order.
    low, high = narrow(widen(t_min) * inverse) + ZERO_F32, narrow(widen(t_max) * inverse) + ZERO_F32
    return is_usual, power, power * frame.inverse_scale, low, high


@device
def _load_group(group, source, first, frame, status):
    """Load 16 rays and make them local; returns whether one of them took the slow path."""
    wx, wy, wz = load_origins(source, first)
    dx, dy, dz = load_directions(source, first)
    t_min = _numbers(source.t_min, source.t_min_step, first)
    t_max = _numbers(source.t_max, source.t_max_step, first)
    ox = narrow((wx - frame.center[0]) * frame.scale)
    oy = narrow((wy - frame.center[1]) * frame.scale)
    oz = narrow((wz - frame.center[2]) * frame.scale)

    # The condition for the fast path is that of `ray_source.load_ray`.
    is_usual, power, t_scale, low, high = scale_lanes((dx, dy, dz), t_min, t_max, frame)
    reach = NEAR_REACH * frame.max_coordinate
    near_by = maximum(maximum(absolute(ox), absolute(oy)), absolute(oz)) <= reach
    is_fast = (
        is_usual
        & (absolute(ox) + absolute(oy) + absolute(oz) < INF_F32)
        & near_by
        & (widen(narrow(t_scale)) == t_scale)
        & (widen(low) * t_scale == widen(t_min))
        & (widen(high) * t_scale == widen(t_max))
    )
    origin, direction = group.origin, group.direction
    origin[_X], origin[_Y], origin[_Z] = ox, oy, oz
    direction[_X] = narrow(dx * power)
    direction[_Y] = narrow(dy * power)
    direction[_Z] = narrow(dz * power)
    group.t_min, group.t, group.t_scale = low, high, narrow(t_scale)
    if all_lanes(is_fast):
        return False
    group.slow_t_scale, group.slow_t_offset = t_scale, f64x16(np.float64(0.0))
    lanes = GroupLanes(address_of(group))
    bits = mask_bits(is_fast) ^ _ALL_LANES
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        _patch(lanes, lane, status, source, first + lane, frame)
    return True


@device_call
def _load_few(lanes, source, first, count, frame, status):
    """Load fewer than 16 rays one by one; the other lanes repeat the last one, inactive."""
    no_inline()
    for lane in range(_LANES):
        _patch(lanes, lane, status, source, first + min(lane, count - ONE_U64), frame)
        if lane >= count:
            lanes.t[lane], lanes.t_min[lane] = -INF_F32, INF_F32


@device
def prepare_group(group, max_coordinate):
    """`kernels.ray.prepare_ray` of a group, and its direction classes."""
    ox, oy, oz = three(group.origin)
    dx, dy, dz = three(group.direction)
    ax, ay, az = absolute(dx), absolute(dy), absolute(dz)
    is_y = ay > ax
    largest = maximum(ay, ax)
    is_z = az > largest
    largest = maximum(az, largest)
    tiny = largest * TINY_DIRECTION
    reach = maximum(maximum(absolute(ox), absolute(oy)), absolute(oz))
    pad = (reach + max_coordinate) * PAD
    one = f32x16(ONE_F32)
    inv_x = copy_sign(one / maximum(ax, tiny), dx)
    inv_y = copy_sign(one / maximum(ay, tiny), dy)
    inv_z = copy_sign(one / maximum(az, tiny), dz)
    pad_x, pad_y, pad_z = copy_sign(pad, dx), copy_sign(pad, dy), copy_sign(pad, dz)
    inv, near, far, shear = group.inv, group.near, group.far, group.shear
    inv[_X], inv[_Y], inv[_Z] = inv_x, inv_y, inv_z
    near[_X] = -((ox + pad_x) * inv_x)
    near[_Y] = -((oy + pad_y) * inv_y)
    near[_Z] = -((oz + pad_z) * inv_z)
    far[_X] = -((ox - pad_x) * inv_x)
    far[_Y] = -((oy - pad_y) * inv_y)
    far[_Z] = -((oz - pad_z) * inv_z)
    sz = select(is_z, inv_z, select(is_y, inv_y, inv_x))
    shear[_X] = select(is_z, dx, select(is_y, dz, dy)) * sz
    shear[_Y] = select(is_z, dy, select(is_y, dx, dz)) * sz
    shear[_Z] = sz
    # Class: 4 * octant + largest axis; NO_CLASS for a ray that cannot hit anything.
    sign_bits = np.int32(31)
    octant = (
        ((float_as_bits(dx) >> sign_bits) & np.int32(4))
        | ((float_as_bits(dy) >> sign_bits) & np.int32(8))
        | ((float_as_bits(dz) >> sign_bits) & np.int32(16))
    )
    zero = i32x16(np.int32(0))
    axis = select(is_z, zero + np.int32(2), select(is_y, zero + np.int32(1), zero))
    can_hit = group.t_min <= group.t
    group.direction_class = select(can_hit, octant | axis, zero + NO_CLASS)
    group.prim_id, group.u, group.v = i32x16(NO_PRIM), f32x16(ZERO_F32), f32x16(ZERO_F32)


@device
def load_group(group, first, count, source, frame, status):
    """Load and prepare `count` rays from `first` on as a group; the other lanes are inactive.

    Returns whether any ray took the slow path: then `slow_t_scale` and `slow_t_offset` are valid.
    """
    is_slow = True
    if count == _LANES:
        is_slow = _load_group(group, source, first, frame, status)
    elif count == ZERO_U64:
        zero, one = f32x16(ZERO_F32), f32x16(ONE_F32)
        origin, direction = group.origin, group.direction
        origin[_X], origin[_Y], origin[_Z] = zero, zero, zero
        direction[_X], direction[_Y], direction[_Z] = one, one, one
        group.t_min, group.t = one, f32x16(-INF_F32)
        is_slow = False
    else:
        _load_few(GroupLanes(address_of(group)), source, first, count, frame, status)
    prepare_group(group, frame.max_coordinate)
    return is_slow


@device
def set_slow(group):
    """Write what a group without rays that took the slow path leaves out."""
    group.slow_t_scale = widen(group.t_scale)
    group.slow_t_offset = f64x16(np.float64(0.0))


@device
def _load_part(packet, g, first, count, source):
    """Load fewer than 16 rays with those behind them, which become inactive.

    A group as of rays that took the slow path, so that its results are written one by one.
    """
    group = Group(packet, g)
    if not load_group(group, first, _LANES, source.rays, source.frame, source.status):
        set_slow(group)
    lanes = GroupLanes(packet, g)
    for lane in range(count, _LANES):
        lanes.t[lane], lanes.t_min[lane] = -INF_F32, INF_F32
        lanes.direction_class[lane] = NO_CLASS


@device
def _prefetch_rows(base, step, first, count):
    begin = base + first * step
    for at in range(begin, begin + count * step, _LINE):
        prefetch(at)


@device
def prefetch_group(number, g, source):
    """Prefetch the rays of a group of a packet that is loaded later, if it is a tile.

    The processor foresees consecutive rays, but not a tile's rows: waiting for them took up to a
    quarter of the time of camera rays.
    """
    rays, order = source.rays, source.order
    is_tile = order.width | order.table != ZERO_U64
    if is_tile and number < np.uint64(order.packet_count):
        first, count = group_rows(order, number, g)
        _prefetch_rows(rays.origins, rays.origin_step, first, count)
        _prefetch_rows(rays.directions, rays.direction_step, first, count)
        _prefetch_rows(rays.t_min, rays.t_min_step, first, count)
        _prefetch_rows(rays.t_max, rays.t_max_step, first, count)


@device
def load_packet(packet, number, source):
    """Load and prepare a packet, and prefetch the next one's rays.

    Parameters
    ----------
    packet : uint64
        Address of `PACKET_BYTES` bytes.
    number : uint64
        Index of the packet in the batch.
    source : PacketSource

    Returns
    -------
    uint64
        Bits of the groups with a ray that took the slow path, for `store_packet`.
    """
    slow_groups = ZERO_U64
    for g in range(GROUPS):
        prefetch_group(number + ONE_U64, g, source)
        first, count = group_rows(source.order, number, g)
        if count != _LANES and count != ZERO_U64 and first + _LANES <= source.order.ray_count:
            _load_part(packet, g, first, count, source)
            slow_groups |= ONE_U64 << g
            continue
        if load_group(Group(packet, g), first, count, source.rays, source.frame, source.status):
            slow_groups |= ONE_U64 << g
    return slow_groups
