"""Load a packet: 16 rays at a time, made local and prepared for the tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.core.rays import INVALID
from raystream.jit.constants import (
    INF_F32,
    ONE_F32,
    ONE_U64,
    ZERO_F32,
    ZERO_F64,
    ZERO_U64,
)
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    all_lanes,
    count_trailing_zeros,
    f32x16,
    f64x16,
    float_as_bits,
    i32x16,
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
from raystream.kernels.ray import PAD, TINY_DIRECTION, WorldRay, largest, slab_constants
from raystream.kernels.ray_source import load_ray, near_ray
from raystream.structures.bvh.packets.rays import (
    GROUP_BYTES,
    GROUPS,
    NO_CLASS,
    NO_PRIM,
    Group,
    GroupLanes,
    group_rows,
    put_local,
    put_local_of_lane,
    put_three,
    three,
)

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
def _limits(at, step, first, lanes, number):
    if step == ZERO_U64:
        return lanes(load(number, at))
    return load(lanes, at + first * step)


@device
def read_lanes(source, first, lanes, number):
    """Read 16 consecutive rays: a `WorldRay` of vectors.

    Parameters
    ----------
    source : RaySource
    first : uint64
    lanes, number : type
        Of the limits: vector and number.
    """
    return WorldRay(
        _triples(source.origins, source.origin_step, source.origins_are_double, first),
        _triples(source.directions, source.direction_step, source.directions_are_double, first),
        _limits(source.t_min, source.t_min_step, first, lanes, number),
        _limits(source.t_max, source.t_max_step, first, lanes, number),
    )


def lanes_loader(
    read: Callable[..., Any],
    move: Callable[..., Any],
    put: Callable[..., Any],
    load_one: Callable[..., Any],
) -> Callable[..., Any]:
    """Make the loader of sixteen rays into the frame in which they are searched.

    Parameters
    ----------
    read : device function
        ``read(source, first)``: 16 rays as vectors, a `WorldRay`.
    move : device function
        ``move(ray, source) -> (is_so, moved)``: these rays in the frame, and the mask of those for
        which that is right.
    put : device function
        ``put(at, moved, is_so)`` writes them to the group at an address.
    load_one : device function
        ``load_one(at, lane, source, i, is_traced)`` loads ray i into a lane by itself, as one that
        is not traced if so.

    Returns
    -------
    device function
        ``load(at, source, first, count) -> uint64`` loads the `count` rays from `first` on, at
        least one; the last one is repeated, but not traced. Returns the bits of the lanes that
        were loaded by themselves.
    """

    @device
    def load_lanes(at, source, first, count):
        singly = _ALL_LANES
        if count == _LANES:
            is_so, moved = move(read(source, first), source)
            put(at, moved, is_so)
            singly ^= mask_bits(is_so)
        left = singly
        while left != ZERO_U64:
            lane = count_trailing_zeros(left)
            left &= left - ONE_U64
            load_one(at, lane, source, first + min(lane, count - ONE_U64), lane < count)
        return singly

    return load_lanes


@device
def _read(source, first):
    return read_lanes(source.rays, first, f32x16, np.float32)


@device
def _move(ray, source):
    is_so, local = near_ray(ray, source.frame)
    # Of rays that did not take the slow path, a group keeps the scale in float32.
    return is_so & (widen(narrow(local.t_scale)) == local.t_scale), local


@device
def _put(at, local, is_so):
    group = Group(at)
    put_local(group, local)
    group.t_scale = narrow(local.t_scale)
    if not all_lanes(is_so):
        set_slow(group)


@device_call
def _load_one(at, lane, source, i, is_traced):
    """Load one ray into a lane of a group by the slow path."""
    no_inline()
    ray, lanes = load_ray(source.rays, i, source.frame), GroupLanes(at)
    put_local_of_lane(lanes, lane, ray)
    if ray.status == INVALID:
        store(source.status + i, INVALID)
    if not is_traced:
        lanes.t[lane], lanes.t_min[lane] = -INF_F32, INF_F32


_load_lanes = lanes_loader(_read, _move, _put, _load_one)


@device
def prepare_group(group, max_coordinate):
    """`kernels.ray.prepare_ray` of a group, and its direction classes."""
    origin, direction = three(group.origin), three(group.direction)
    dx, dy, dz = direction
    ax, ay, az = absolute(dx), absolute(dy), absolute(dz)
    is_y, is_z = ay > ax, az > maximum(ay, ax)
    tiny, pad = largest(direction) * TINY_DIRECTION, (largest(origin) + max_coordinate) * PAD
    inv, near, far = slab_constants(origin, direction, tiny, pad, ONE_F32)
    put_three(group.inv, inv)
    put_three(group.near, near)
    put_three(group.far, far)
    sz = select(is_z, inv[2], select(is_y, inv[1], inv[0]))
    shear_x = select(is_z, dx, select(is_y, dz, dy)) * sz
    shear_y = select(is_z, dy, select(is_y, dx, dz)) * sz
    put_three(group.shear, (shear_x, shear_y, sz))
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
def load_group(at, first, count, source):
    """Load and prepare rays as the group at an address.

    Parameters
    ----------
    at : uint64
    first, count : uint64
        The rays are `count` from `first` on; the other lanes are inactive.
    source : PacketSource

    Returns
    -------
    bool
        Whether any ray took the slow path: then `slow_t_scale` and `slow_t_offset` are valid.
    """
    group, singly = Group(at), ZERO_U64
    if count != ZERO_U64:
        singly = _load_lanes(at, source, first, count)
    else:
        zero, one = f32x16(ZERO_F32), f32x16(ONE_F32)
        put_three(group.origin, (zero, zero, zero))
        put_three(group.direction, (one, one, one))
        group.t_min, group.t = one, f32x16(-INF_F32)
    prepare_group(group, source.frame.max_coordinate)
    return singly != ZERO_U64


@device
def set_slow(group):
    """Write what a group without rays that took the slow path leaves out."""
    group.slow_t_scale = widen(group.t_scale)
    group.slow_t_offset = f64x16(ZERO_F64)


@device
def _load_part(at, first, count, source):
    """Load fewer than 16 rays with those behind them, which become inactive.

    A group as of rays that took the slow path, so that its results are written one by one.
    """
    if not load_group(at, first, _LANES, source):
        set_slow(Group(at))
    lanes = GroupLanes(at)
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
        at, is_slow = packet + g * GROUP_BYTES, True
        if count != _LANES and count != ZERO_U64 and first + _LANES <= source.order.ray_count:
            _load_part(at, first, count, source)
        else:
            is_slow = load_group(at, first, count, source)
        slow_groups |= np.uint64(is_slow) << g
    return slow_groups
