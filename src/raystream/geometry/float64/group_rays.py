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
from raystream.geometry.float64.ray import Line, make_line, usual_line
from raystream.geometry.float64.search import NO_PRIM, Nearest
from raystream.jit.constants import INF_F32, INF_F64, ONE_F64, ZERO_F64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import f64x16, i32x16, i64x16
from raystream.jit.views import view
from raystream.kernels.ray import SceneFrame, largest, to_frame
from raystream.kernels.ray_source import RaySource, read_float64_ray
from raystream.structures.bvh.packets.load import lanes_loader, read_lanes
from raystream.structures.bvh.packets.rays import (
    PacketOrder,
    put_three,
    put_three_of_lane,
    three_of_lane,
)

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
_NO_TRIANGLE = np.int64(0)


@device
def exact_ray(lanes, k):
    """A ray as triangles are tested with."""
    origin, direction = three_of_lane(lanes.origin, k), three_of_lane(lanes.direction, k)
    return Line(origin, direction, lanes.t_min[k], lanes.t_max[k])


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


@device
def _is_near(line, frame):
    return largest(to_frame(line.origin, frame)) <= _FAR * np.float64(frame.max_coordinate)


@device
def _read(source, first):
    return read_lanes(source.exact, first, f64x16, np.float64)


@device
def _move(ray, source):
    is_so, line, half = usual_line(ray)
    return is_so & _is_near(line, source.frame), (line, half)


@device
def _put(at, moved, is_so):
    group, (line, half) = Float64Group(at), moved
    put_three(group.origin, line.origin)
    put_three(group.direction, line.direction)
    group.t_min, group.t_max, group.far = line.t_min, line.t_max, line.t_max
    group.half, group.rest, group.is_alone = half, f64x16(ONE_F64), i32x16(np.int32(0))


@device_call
def _load_one(at, k, source, i, is_traced):
    """Load ray i as lane k."""
    no_inline()
    lanes = Float64Lanes(at)
    line, half, rest, status = make_line(read_float64_ray(source.exact, i))
    put_three_of_lane(lanes.origin, k, line.origin)
    put_three_of_lane(lanes.direction, k, line.direction)
    lanes.t_min[k], lanes.t_max[k], lanes.far[k] = line.t_min, line.t_max, line.t_max
    lanes.half[k], lanes.rest[k], lanes.is_alone[k] = half, rest, np.int32(0)
    if status != VALID or not _is_near(line, source.frame):
        lanes.is_alone[k], lanes.far[k] = np.int32(1), -INF_F64
    if not is_traced:
        lanes.far[k] = -INF_F64


_load_lanes = lanes_loader(_read, _move, _put, _load_one)


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
    _load_lanes(at, source, first, count)
    group.low, group.high = f64x16(INF_F64), f64x16(INF_F64)
    group.triangle, group.prim_id = i64x16(_NO_TRIANGLE), i32x16(NO_PRIM)
    group.scale = f64x16(np.float64(source.frame.scale))
    group.offset = f64x16(ZERO_F64)
    if is_slow:
        for k in range(_LANES):
            lanes.offset[k] = local.slow_t_offset[k] / local.slow_t_scale[k]
            if lanes.far[k] == -INF_F64:
                local.t[k] = -INF_F32
