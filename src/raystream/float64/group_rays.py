"""Sixteen rays in float64, a vector for each number: loaded, and written with their nearest hits.

Beside the groups of `structures.bvh.packet_rays`, whose boxes' tests are in float32 with their
padding: it exceeds the rounding of the rays, and the boxes hold the triangles for sure. Each ray
has the interval of its nearest hit's distance; its upper end, rounded up to float32, is what boxes
are compared to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayStatus
from raystream.float64.block import SECOND, THIRD
from raystream.float64.exact import barycentrics, estimate
from raystream.float64.queries import tree_searches, write_nearest
from raystream.float64.ray import (
    LEAST_EXPONENT,
    MOST_COORDINATE,
    MOST_EXPONENT,
    Line,
    largest,
    local_origin,
    make_line,
    ray_of_line,
    reported,
    without_least,
)
from raystream.float64.search import NO_PRIM, Nearest
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    all_lanes,
    any_lane,
    bits_as_float,
    count_trailing_zeros,
    f64x16,
    float_as_bits,
    gather,
    i32x16,
    i64x16,
    load,
    mask_bits,
    select,
    store,
)
from raystream.jit.views import view
from raystream.kernels.ray import MANTISSA_BITS, POWER_EXPONENT, SceneFrame
from raystream.kernels.ray_source import RaySource, load_direction, load_origin
from raystream.structures.bvh.packet_load import load_directions, load_origins
from raystream.structures.bvh.packet_rays import PacketOrder, PacketSource, three

_NUMBERS = (
    ("t_min", "f8"),
    ("far", "f8"),  # the end of the interval; -inf for a ray that is not traced here
    ("low", "f8"),
    ("high", "f8"),
    ("half", "f8"),
    ("rest", "f8"),
    ("scale", "f8"),  # t in float32, in the local frame, is t * scale - offset
    ("offset", "f8"),
    ("place", "i8"),
    ("prim_id", "i4"),
    ("state", "i4"),
)

#: Rays and their nearest hits; and with a lane index.
FLOAT64_GROUP = np.dtype(
    [
        ("origin", "f8", (3, 16)),
        ("direction", "f8", (3, 16)),
        ("t_max", "f8", 16),
        *((name, kind, 16) for name, kind in _NUMBERS),
    ]
)
GROUP_BYTES = np.uint64(FLOAT64_GROUP.itemsize)
Float64Group = view(FLOAT64_GROUP)
Float64Lanes = view(
    [
        ("origin", "f8", (3, 16, 1)),
        ("direction", "f8", (3, 16, 1)),
        ("t_max", "f8", (16, 1)),
        *((name, kind, (16, 1)) for name, kind in _NUMBERS),
    ]
)
#: `state`: of an invalid ray, and of one that is traced by itself.
INVALID = np.int32(RayStatus.INVALID)
ALONE = np.int32(2)

#: Origins that are further from the scene's middle than this many times its largest coordinate are
#: traced by themselves: moved to the scene, as float32 needs it, they would lose too many digits.
_FAR = 2.0**20

_nearest, _anything = tree_searches.nearest, tree_searches.anything

_LANES = np.uint64(16)
_ALL = np.uint64(0xFFFF)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_INF, _ZERO, _UNIT = np.float64(np.inf), np.float64(0.0), np.float64(1.0)
_INF32 = np.float32(np.inf)
_NO_PLACE, _SHIFT64 = np.int64(0), np.int64(3)
_MISS = np.int32(-1)


@device
def exact_ray(lanes, k):
    """A ray as triangles are tested with."""
    origin, direction = lanes.origin, lanes.direction
    return Line(
        (origin[_X, k], origin[_Y, k], origin[_Z, k]),
        (direction[_X, k], direction[_Y, k], direction[_Z, k]),
        lanes.t_min[k],
        lanes.t_max[k],
    )


@device
def nearest_of(lanes, k):
    """The nearest hit of a ray so far."""
    return Nearest(lanes.low[k], lanes.high[k], np.uint64(lanes.place[k]), lanes.prim_id[k])


# Loading


class Float64Packets(NamedTuple):
    """A `PacketSource` with limits in float64, too.

    Attributes
    ----------
    rays, order, frame, status
        See `PacketSource`; the limits are rounded to float32, outward.
    t_min, t_max : uint64
        Addresses of a float64 per ray.
    t_min_step, t_max_step : uint64
        Strides in bytes: 0 where all rays share one value.
    """

    rays: RaySource
    order: PacketOrder
    frame: SceneFrame
    status: np.uint64
    t_min: np.uint64
    t_min_step: np.uint64
    t_max: np.uint64
    t_max_step: np.uint64

    @classmethod
    def of(
        cls, packets: PacketSource, t_min: NDArray[np.float64], t_max: NDArray[np.float64]
    ) -> Float64Packets:
        """The packets of rays with limits of shape (N,) or (1,); the caller keeps these alive."""
        numbers = [(one.ctypes.data, 8 if len(one) > 1 else 0) for one in (t_min, t_max)]
        return cls(*packets, *np.array(numbers, np.uint64).reshape(-1))


@device_call
def _load_one(lanes, k, source, i):
    """Load ray i as lane k."""
    no_inline()
    rays, frame = source.rays, source.frame
    t_min = load(np.float64, source.t_min + i * source.t_min_step)
    t_max = load(np.float64, source.t_max + i * source.t_max_step)
    line, half, rest, status = make_line(
        load_origin(rays, i), load_direction(rays, i), t_min, t_max
    )
    origin, direction = lanes.origin, lanes.direction
    origin[_X, k], origin[_Y, k], origin[_Z, k] = line.origin
    direction[_X, k], direction[_Y, k], direction[_Z, k] = line.direction
    lanes.t_min[k], lanes.t_max[k], lanes.far[k] = line.t_min, line.t_max, line.t_max
    lanes.half[k], lanes.rest[k], lanes.state[k] = half, rest, np.int32(status)
    if not largest(local_origin(line.origin, frame)) <= _FAR * np.float64(frame.max_coordinate):
        lanes.state[k] |= ALONE
        lanes.far[k] = -_INF


@device
def _limits(at, step, first):
    if step != ZERO_U64:
        return load(f64x16, at + first * step)
    return f64x16(load(np.float64, at))


@device
def _sum(x):
    return absolute(x[0]) + absolute(x[1]) + absolute(x[2])


@device
def _put_triple(rows, x):
    rows[_X], rows[_Y], rows[_Z] = x


@device
def _load_all(group, source, first):
    """Load 16 rays; returns False if one of them is unusual."""
    rays, frame = source.rays, source.frame
    given, direction = load_origins(rays, first), load_directions(rays, first)
    t_min = _limits(source.t_min, source.t_min_step, first)
    t_max = _limits(source.t_max, source.t_max_step, first)
    # Step 1: whether one product scales each direction, and all numbers are valid: a NaN fails.
    exponent = float_as_bits(largest(direction)) >> MANTISSA_BITS
    origin = without_least(given)
    is_usual = (
        (exponent >= LEAST_EXPONENT)
        & (exponent <= MOST_EXPONENT)
        & (_sum(direction) < _INF)
        & (_sum(given) <= MOST_COORDINATE)
        & (largest(local_origin(origin, frame)) <= _FAR * np.float64(frame.max_coordinate))
        & (t_min == t_min)
        & (t_max == t_max)
    )
    if not all_lanes(is_usual):
        return False
    # Step 2: as `ray.make_line`.
    half = bits_as_float((i64x16(POWER_EXPONENT) - exponent) << MANTISSA_BITS)
    inverse = bits_as_float(exponent << MANTISSA_BITS)
    dx, dy, dz = direction
    _put_triple(group.origin, origin)
    _put_triple(group.direction, without_least((dx * half, dy * half, dz * half)))
    t_max = t_max * inverse
    group.t_min, group.t_max, group.far = t_min * inverse, t_max, t_max
    group.half, group.rest, group.state = half, f64x16(_UNIT), i32x16(np.int32(0))
    return True


@device
def load_rays(at, source, first, count, is_slow, local):
    """Load rays, at most 16.

    Parameters
    ----------
    at : uint64
        Address of a `FLOAT64_GROUP`.
    source : Float64Packets
    first, count : uint64
        The rays are `count` from `first` on; further lanes are not traced.
    is_slow : bool
        What `packet_load.load_group` returned for them.
    local : GroupLanes
        The group that it loaded. Lanes that are not traced here become inactive.
    """
    group, lanes = Float64Group(at), Float64Lanes(at)
    if count != _LANES or not _load_all(group, source, first):
        for k in range(_LANES):
            _load_one(lanes, k, source, first + min(k, count - ONE_U64))
            if k >= count:
                lanes.far[k] = -_INF
    group.low, group.high = f64x16(_INF), f64x16(_INF)
    group.place, group.prim_id = i64x16(_NO_PLACE), i32x16(NO_PRIM)
    group.scale = f64x16(np.float64(source.frame.scale))
    group.offset = f64x16(_ZERO)
    if is_slow:
        for k in range(_LANES):
            lanes.offset[k] = local.slow_t_offset[k] / local.slow_t_scale[k]
            if lanes.far[k] == -_INF:
                local.t[k] = -_INF32


# Results


@device
def _vertex(leaves, index, at):
    step = np.int64(4)
    base = leaves + at
    return (
        gather(np.float64, base, index),
        gather(np.float64, base, index + step),
        gather(np.float64, base, index + (step + step)),
    )


@device
def _finish_all(group, first, tree, out):
    """Write the nearest hits of 16 rays; returns bits of those in doubt."""
    place, at = group.place, first << SHIFT_64
    is_hit, zero = place != _NO_PLACE, f64x16(_ZERO)
    t_at, u_at, v_at = out.t + at, out.u + at, out.v + at
    prim_id = select(is_hit, group.prim_id, i32x16(_MISS))
    store(out.prim_id + (first << SHIFT_32), prim_id)
    if not any_lane(is_hit):
        store(t_at, f64x16(_INF))
        store(u_at, zero)
        store(v_at, zero)
        return ZERO_U64
    index = select(is_hit, (place - np.int64(tree.leaves)) >> _SHIFT64, i64x16(_NO_PLACE))
    hit = estimate(
        _vertex(tree.leaves, index, ZERO_U64),
        _vertex(tree.leaves, index, SECOND),
        _vertex(tree.leaves, index, THIRD),
        three(group.origin),
        three(group.direction),
    )
    _, weight_v, weight_w, inverse = hit.weights
    u, v = barycentrics(weight_v, weight_w, inverse)
    store(t_at, select(is_hit, reported(hit.t, group), f64x16(_INF)))
    store(u_at, select(is_hit, u, zero))
    store(v_at, select(is_hit, v, zero))
    return mask_bits(is_hit) & ~mask_bits(hit.is_sure & hit.is_rounded)


@device_call
def _finish_one(lanes, k, i, tree, frame, wants_any, out, memory):
    """Write the result of ray i; one that is traced by itself is traced now."""
    no_inline()
    state = lanes.state[k]
    is_alone = state & ALONE != np.int32(0)
    if state & INVALID:
        store(out.status + i, np.uint8(RayStatus.INVALID))
    ray = ray_of_line(exact_ray(lanes, k), lanes.half[k], lanes.rest[k], np.uint8(0), frame)
    best = nearest_of(lanes, k)
    if wants_any:
        is_hit = best.prim_id != NO_PRIM
        if is_alone:
            is_hit = _anything(tree, ray, memory)
        store(out.seen + i, np.uint8(is_hit))
        return
    if is_alone:
        best = _nearest(tree, ray, memory)
    write_nearest(out, i, best, ray)


@device
def finish_rays(at, first, count, tree, frame, wants_any, out, memory):
    """Write the results of rays.

    Parameters
    ----------
    at : uint64
        Address of a `FLOAT64_GROUP`.
    first, count : uint64
        See `load_rays`.
    tree : Float64Tree
    frame : SceneFrame
    wants_any : bool
    out : ResultAddresses
        Its hits are of float64.
    memory : tuple of two uint64
        See `queries.Searches`.
    """
    group, lanes = Float64Group(at), Float64Lanes(at)
    is_usual = count == _LANES and not any_lane(group.state != np.int32(0))
    if is_usual and wants_any:
        bits, to = mask_bits(group.prim_id != NO_PRIM), out.seen + first
        for k in range(_LANES):
            store(to + k, np.uint8((bits >> k) & ONE_U64))
        return
    if not is_usual:
        for k in range(count):
            _finish_one(lanes, k, first + k, tree, frame, wants_any, out, memory)
        return
    left = _finish_all(group, first, tree, out)
    while left != ZERO_U64:
        k = count_trailing_zeros(left)
        left &= left - ONE_U64
        _finish_one(lanes, k, first + k, tree, frame, False, out, memory)
