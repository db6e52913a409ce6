"""Sixteen rays in float64, a vector for each number.

Beside the groups of `structures.bvh.packets.rays`, whose boxes' tests are in float32 with their
padding: it exceeds the rounding of the rays, and the boxes hold the triangles for sure. Each ray
has the interval of its nearest hit's distance; its upper end, rounded up to float32, is what boxes
are compared to.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import VALID
from raystream.geometry.float64.ray import (
    LEAST_EXPONENT,
    MOST_COORDINATE,
    MOST_EXPONENT,
    Line,
    largest,
    local_origin,
    make_line,
    without_least,
)
from raystream.geometry.float64.search import NO_PRIM, Nearest
from raystream.jit.constants import INF_F32, INF_F64, ONE_U64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    all_lanes,
    bits_as_float,
    f64x16,
    float_as_bits,
    i32x16,
    i64x16,
    load,
)
from raystream.jit.views import view
from raystream.kernels.ray import MANTISSA_BITS, POWER_EXPONENT, SceneFrame
from raystream.kernels.ray_source import RaySource, load_direction, load_origin
from raystream.structures.bvh.packets.load import load_directions, load_origins
from raystream.structures.bvh.packets.rays import PacketOrder

_NUMBERS = (
    ("t_min", "f8"),
    ("far", "f8"),  # the end of the interval; -inf for a ray that is not traced here
    ("low", "f8"),
    ("high", "f8"),
    ("half", "f8"),
    ("rest", "f8"),
    ("scale", "f8"),  # t in float32, in the local frame, is t * scale - offset
    ("offset", "f8"),
    ("triangle", "i8"),
    ("prim_id", "i4"),
    ("is_alone", "i4"),  # whether it is traced by itself, see `group_results`
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

#: Rays whose origins are further from the scene's middle than this many times its largest
#: coordinate are traced by themselves: moved to the scene, as float32 needs it, they would lose too
#: many digits.
_FAR = 2.0**20


_LANES = np.uint64(16)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_UNIT = np.float64(1.0)
_NO_TRIANGLE = np.int64(0)


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
    return Nearest(lanes.low[k], lanes.high[k], np.uint64(lanes.triangle[k]), lanes.prim_id[k])


# Loading


class Float64Packets(NamedTuple):
    """A `PacketSource` with limits in float64, too.

    Attributes
    ----------
    rays, order, frame, status
        See `PacketSource`; the limits are rounded to float32, outward.
    exact : RaySource
        The same rays with limits in float64.
    """

    rays: RaySource
    order: PacketOrder
    frame: SceneFrame
    status: np.uint64
    exact: RaySource


@device_call
def _load_one(lanes, k, source, i):
    """Load ray i as lane k."""
    no_inline()
    rays, frame = source.exact, source.frame
    t_min = load(np.float64, rays.t_min + i * rays.t_min_step)
    t_max = load(np.float64, rays.t_max + i * rays.t_max_step)
    line, half, rest, status = make_line(
        load_origin(rays, i), load_direction(rays, i), t_min, t_max
    )
    origin, direction = lanes.origin, lanes.direction
    origin[_X, k], origin[_Y, k], origin[_Z, k] = line.origin
    direction[_X, k], direction[_Y, k], direction[_Z, k] = line.direction
    lanes.t_min[k], lanes.t_max[k], lanes.far[k] = line.t_min, line.t_max, line.t_max
    lanes.half[k], lanes.rest[k], lanes.is_alone[k] = half, rest, np.int32(0)
    reach, most = largest(local_origin(line.origin, frame)), np.float64(frame.max_coordinate)
    if status != VALID or not reach <= _FAR * most:
        lanes.is_alone[k], lanes.far[k] = np.int32(1), -INF_F64


@device
def _limits(at, step, first):
    if step != ZERO_U64:
        return load(f64x16, at + first * step)
    return f64x16(load(np.float64, at))


@device
def _sum(x):
    return absolute(x[0]) + absolute(x[1]) + absolute(x[2])


@device
def put_triple(rows, x):
    """Write three vectors to a field with one per axis."""
    rows[_X], rows[_Y], rows[_Z] = x


@device
def _load_all(group, source, first):
    """Load 16 rays; returns False if one of them is unusual."""
    rays, frame = source.exact, source.frame
    given, direction = load_origins(rays, first), load_directions(rays, first)
    t_min = _limits(rays.t_min, rays.t_min_step, first)
    t_max = _limits(rays.t_max, rays.t_max_step, first)
    # Step 1: whether one product scales each direction, and all numbers are valid: a NaN fails.
    exponent = float_as_bits(largest(direction)) >> MANTISSA_BITS
    origin = without_least(given)
    is_usual = (
        (exponent >= LEAST_EXPONENT)
        & (exponent <= MOST_EXPONENT)
        & (_sum(direction) < INF_F64)
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
    put_triple(group.origin, origin)
    put_triple(group.direction, without_least((dx * half, dy * half, dz * half)))
    t_max = t_max * inverse
    group.t_min, group.t_max, group.far = t_min * inverse, t_max, t_max
    group.half, group.rest, group.is_alone = half, f64x16(_UNIT), i32x16(np.int32(0))
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
        What `packets.load.load_group` returned for them.
    local : GroupLanes
        The group that it loaded. Lanes that are not traced here become inactive.
    """
    group, lanes = Float64Group(at), Float64Lanes(at)
    if count != _LANES or not _load_all(group, source, first):
        for k in range(_LANES):
            _load_one(lanes, k, source, first + min(k, count - ONE_U64))
            if k >= count:
                lanes.far[k] = -INF_F64
    group.low, group.high = f64x16(INF_F64), f64x16(INF_F64)
    group.triangle, group.prim_id = i64x16(_NO_TRIANGLE), i32x16(NO_PRIM)
    group.scale = f64x16(np.float64(source.frame.scale))
    group.offset = f64x16(ZERO_F64)
    if is_slow:
        for k in range(_LANES):
            lanes.offset[k] = local.slow_t_offset[k] / local.slow_t_scale[k]
            if lanes.far[k] == -INF_F64:
                local.t[k] = -INF_F32
