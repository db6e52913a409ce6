"""Sixteen rays in float64, a vector for each number: loaded, tested against triangles, and written.

Beside the groups of `structures.bvh.packet_rays`, whose boxes' tests are in float32 with their
padding: it exceeds the rounding of the rays, and the boxes hold the triangles for sure. Each ray
has the interval of its nearest hit's distance; its upper end, rounded up to float32, is what boxes
are compared to.
"""

from __future__ import annotations

import numpy as np

from raystream.core.rays import RayStatus
from raystream.float64.block import (
    SECOND,
    THIRD,
    interval_of,
    sides_of,
)
from raystream.float64.exact import settle
from raystream.float64.queries import tree_searches, write_nearest
from raystream.float64.ray import (
    LEAST,
    LEAST_EXPONENT,
    MOST_COORDINATE,
    MOST_EXPONENT,
    Line,
    local_origin,
    make_line,
    ray_of_line,
)
from raystream.float64.search import NO_PRIM, Nearest, is_counted, offer, within
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    address,
    all_lanes,
    any_lane,
    bits_as_float,
    count_trailing_zeros,
    f32x16,
    f64x16,
    float_as_bits,
    gather,
    i32x16,
    i64x16,
    load,
    mask_bits,
    maximum,
    minimum,
    narrow,
    next_float_up,
    select,
    store,
)
from raystream.jit.views import view
from raystream.kernels.hits import hit_addresses
from raystream.kernels.ray import MANTISSA_BITS, POWER_EXPONENT
from raystream.kernels.ray_source import (
    load_direction,
    load_origin,
)
from raystream.structures.bvh.packet_load import load_directions, load_origins
from raystream.structures.bvh.packet_rays import three

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
_INVALID = np.int32(RayStatus.INVALID)
_ALONE = np.int32(2)

#: Origins that are further from the scene's middle than this many times its largest coordinate are
#: traced by themselves: moved to the scene, as float32 needs it, they would lose too many digits.
_FAR = 2.0**20

#: Distances are rounded up by this part of the offset, whose own rounding it covers.
_OFFSET_SLACK = 2.0**-50

#: More than a step of float32, as a part of a number, and near 0.
_STEPS, _LEAST_STEP = np.float32(2.0**-22), np.float32(2.0**-126)

_nearest, _anything = tree_searches.nearest, tree_searches.anything

_LANES = np.uint64(16)
_ALL = np.uint64(0xFFFF)
_MOST_AT = np.uint64(128)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_INF, _ZERO, _UNIT = np.float64(np.inf), np.float64(0.0), np.float64(1.0)
_ZERO32 = np.float32(0.0)
_INF32 = np.float32(np.inf)
_LARGEST = np.float64(np.finfo(np.float64).max)
_NO_PLACE, _SHIFT64 = np.int64(0), np.int64(3)
_MISS = np.int32(-1)


@device
def line_of(lanes, k):
    """The line of a ray."""
    origin, direction = lanes.origin, lanes.direction
    return Line(
        (origin[_X, k], origin[_Y, k], origin[_Z, k]),
        (direction[_X, k], direction[_Y, k], direction[_Z, k]),
        lanes.t_min[k],
        lanes.t_max[k],
    )


@device
def _best_of(lanes, k):
    return Nearest(lanes.low[k], lanes.high[k], np.uint64(lanes.place[k]), lanes.prim_id[k])


# Loading


@device_call
def _load_one(lanes, k, source, i, frame):
    """Load ray i as lane k."""
    no_inline()
    t_min = source.t_min[i if len(source.t_min) > 1 else ZERO_U64]
    t_max = source.t_max[i if len(source.t_max) > 1 else ZERO_U64]
    given, way = load_origin(source.rays, i), load_direction(source.rays, i)
    line, half, rest, status = make_line(given, way, t_min, t_max)
    origin, direction = lanes.origin, lanes.direction
    origin[_X, k], origin[_Y, k], origin[_Z, k] = line.origin
    direction[_X, k], direction[_Y, k], direction[_Z, k] = line.direction
    lanes.t_min[k], lanes.t_max[k], lanes.far[k] = line.t_min, line.t_max, line.t_max
    lanes.half[k], lanes.rest[k], lanes.state[k] = half, rest, np.int32(status)
    x, y, z = local_origin(line, frame)
    if not max(abs(x), abs(y), abs(z)) <= _FAR * np.float64(frame.max_coordinate):
        lanes.state[k] |= _ALONE
        lanes.far[k] = -_INF


@device
def _limits(array, first):
    if len(array) > 1:
        return load(f64x16, address(array) + (first << SHIFT_64))
    return f64x16(array[ZERO_U64])


@device
def _kept(x):
    return select(absolute(x) >= LEAST, x, f64x16(_ZERO))


@device
def _reach(x, y, z):
    return maximum(maximum(absolute(x), absolute(y)), absolute(z))


@device
def _load_all(group, source, first, frame):
    """Load 16 rays; returns False if one of them is unusual."""
    ox, oy, oz = load_origins(source.rays, first)
    dx, dy, dz = load_directions(source.rays, first)
    t_min, t_max = _limits(source.t_min, first), _limits(source.t_max, first)
    exponent = float_as_bits(_reach(dx, dy, dz)) >> MANTISSA_BITS
    ox, oy, oz = _kept(ox), _kept(oy), _kept(oz)
    x = (ox - frame.center[0]) * frame.scale
    y = (oy - frame.center[1]) * frame.scale
    z = (oz - frame.center[2]) * frame.scale
    is_usual = (
        (exponent >= LEAST_EXPONENT)
        & (exponent <= MOST_EXPONENT)
        & (absolute(dx) + absolute(dy) + absolute(dz) < _INF)
        & (absolute(ox) + absolute(oy) + absolute(oz) <= MOST_COORDINATE)
        & (_reach(x, y, z) <= _FAR * np.float64(frame.max_coordinate))
        & (t_min == t_min)
        & (t_max == t_max)
    )
    if not all_lanes(is_usual):
        return False
    half = bits_as_float((i64x16(POWER_EXPONENT) - exponent) << MANTISSA_BITS)
    inverse = bits_as_float(exponent << MANTISSA_BITS)
    origin, direction = group.origin, group.direction
    origin[_X], origin[_Y], origin[_Z] = ox, oy, oz
    direction[_X], direction[_Y] = _kept(dx * half), _kept(dy * half)
    direction[_Z] = _kept(dz * half)
    t_max = t_max * inverse
    group.t_min, group.t_max, group.far = t_min * inverse, t_max, t_max
    group.half, group.rest, group.state = half, f64x16(_UNIT), i32x16(np.int32(0))
    return True


@device
def load_rays(at, source, first, count, frame, is_slow, local):
    """Load rays, at most 16.

    Parameters
    ----------
    at : uint64
        Address of a `FLOAT64_GROUP`.
    source : Float64Source
    first, count : uint64
        The rays are `count` from `first` on; further lanes are not traced.
    frame : SceneFrame
    is_slow : bool
        What `packet_load.load_group` returned for them.
    local : GroupLanes
        The group that it loaded.
    """
    group, lanes = Float64Group(at), Float64Lanes(at)
    if count != _LANES or not _load_all(group, source, first, frame):
        for k in range(_LANES):
            _load_one(lanes, k, source, first + min(k, count - ONE_U64), frame)
            if k >= count:
                lanes.far[k] = -_INF
    group.low, group.high = f64x16(_INF), f64x16(_INF)
    group.place, group.prim_id = i64x16(_NO_PLACE), i32x16(NO_PRIM)
    group.scale = f64x16(np.float64(frame.scale))
    group.offset = f64x16(_ZERO)
    if is_slow:
        for k in range(_LANES):
            lanes.offset[k] = local.slow_t_offset[k] / local.slow_t_scale[k]


# Tests


@device
def short_far(lanes, k):
    """The end of a ray's interval in float32, in the local frame, rounded up."""
    far, offset = lanes.far[k], lanes.offset[k]
    if far == -_INF:
        return -_INF32
    local = far * lanes.scale[k] - offset
    return next_float_up(np.float32(local + abs(offset) * _OFFSET_SLACK))


@device
def keep(lanes, k, low, high, is_sure, place, prim_id, wants_any):
    """Offer a triangle that may be hit to a ray; returns whether its interval has become shorter.

    Parameters
    ----------
    lanes : Float64Lanes
    k : uint64
    low, high, is_sure, place, prim_id
        See `search.offer`.
    wants_any : bool
        The first triangle ends the search.
    """
    line = line_of(lanes, k)
    if wants_any:
        if not ((is_sure and within(line, low, high)) or is_counted(line, place, False)):
            return False
        lanes.prim_id[k], lanes.far[k] = prim_id, -_INF
        return True
    old = _best_of(lanes, k)
    best = offer(line, old, low, high, is_sure, place, prim_id)
    if best.place == old.place and best.high == old.high:
        return False
    lanes.low[k], lanes.high[k] = best.low, best.high
    lanes.place[k], lanes.prim_id[k] = np.int64(best.place), best.prim_id
    lanes.far[k] = min(best.high, line.t_max)
    return True


@device
def _short(far, group):
    """`short_far` of all rays, or a little more."""
    local = far * group.scale - group.offset
    short = narrow(local + absolute(group.offset) * _OFFSET_SLACK)
    return short + absolute(short) * _STEPS + _LEAST_STEP


@device
def intersect_rays(group, allowed, a, edges, place, prim_id, wants_any, spans):
    """Test 16 rays against a triangle, and keep the hits that are certain.

    Parameters
    ----------
    group : Float64Group
    allowed : mask16
        The rays to test.
    a : triple of float64
        Vertex 0.
    edges : tuple
        See `block.triangle_edges`.
    place : uint64
    prim_id : int32
    wants_any : bool
    spans : uint64
        Address of 256 bytes: of the rays in doubt, the least and, 128 bytes behind, the largest
        distance are written.

    Returns
    -------
    taken : mask16
        The rays whose nearest hit this is now.
    far : float32 vector
        The ends of their intervals, rounded up; -inf with `wants_any`.
    doubtful : uint64
        Bits of the rays that `keep` must decide.
    """
    origin, direction = three(group.origin), three(group.direction)
    low, high, error, base, corner, reach = sides_of(a, edges, origin, direction)
    found = allowed & ((low >= -error) | (high <= error))
    if not any_lane(found):
        return found, f32x16(_ZERO32), ZERO_U64
    is_clear, least, most = interval_of(corner, reach, edges, base, error)
    least, most = select(is_clear, least, f64x16(-_INF)), select(is_clear, most, f64x16(_INF))
    found = found & (least <= group.far) & (most >= group.t_min)
    if not any_lane(found):
        return found, f32x16(_ZERO32), ZERO_U64
    best = group.low
    is_sure = is_clear & ((low > error) | (high < -error))
    taken = found & is_sure & (least >= group.t_min) & (most <= group.t_max) & (most < best)
    far = f32x16(-_INF32)
    if any_lane(taken):
        group.prim_id = select(taken, i32x16(prim_id), group.prim_id)
        if wants_any:
            group.far = select(taken, f64x16(-_INF), group.far)
        else:
            group.low, group.high = select(taken, least, best), select(taken, most, group.high)
            group.place = select(taken, i64x16(np.int64(place)), group.place)
            group.far = select(taken, most, group.far)
            far = _short(most, group)
    doubtful = mask_bits(found & ~taken)
    if doubtful != ZERO_U64:
        store(spans, least)
        store(spans + _MOST_AT, select(is_sure, most, f64x16(_INF)))
    return taken, far, doubtful


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
def _finish_all(group, first, tree, rows):
    """Write the nearest hits of 16 rays; returns bits of those that are unsettled."""
    place, at = group.place, first << SHIFT_64
    is_hit, zero = place != _NO_PLACE, f64x16(_ZERO)
    t_at, u_at, v_at = address(rows.t) + at, address(rows.u) + at, address(rows.v) + at
    prim_id = select(is_hit, group.prim_id, i32x16(_MISS))
    store(address(rows.prim_id) + (first << SHIFT_32), prim_id)
    if not any_lane(is_hit):
        store(t_at, f64x16(_INF))
        store(u_at, zero)
        store(v_at, zero)
        return ZERO_U64
    index = select(is_hit, (place - np.int64(tree.leaves)) >> _SHIFT64, i64x16(_NO_PLACE))
    is_settled, t, u, v = settle(
        _vertex(tree.leaves, index, ZERO_U64),
        _vertex(tree.leaves, index, SECOND),
        _vertex(tree.leaves, index, THIRD),
        three(group.origin),
        three(group.direction),
    )
    t = t * group.half * group.rest
    t = minimum(maximum(t, f64x16(-_LARGEST)), f64x16(_LARGEST))
    store(t_at, select(is_hit, t, f64x16(_INF)))
    store(u_at, select(is_hit, u, zero))
    store(v_at, select(is_hit, v, zero))
    return mask_bits(is_hit) & (mask_bits(is_settled) ^ _ALL)


@device_call
def _finish_one(lanes, k, i, tree, frame, wants_any, status, rows, memory):
    """Write the result of ray i; one that is traced by itself is traced now."""
    no_inline()
    state = lanes.state[k]
    is_alone = state & _ALONE != np.int32(0)
    if state & _INVALID:
        status[i] = np.uint8(RayStatus.INVALID)
    ray = ray_of_line(line_of(lanes, k), lanes.half[k], lanes.rest[k], np.uint8(0), frame)
    best = _best_of(lanes, k)
    if wants_any:
        is_hit = best.prim_id != NO_PRIM
        if is_alone:
            is_hit = _anything(tree, ray, memory)
        rows.prim_id[i] = is_hit
        return
    if is_alone:
        best = _nearest(tree, ray, memory)
    write_nearest(hit_addresses(rows), i, best, ray)


@device
def finish_rays(at, first, count, tree, frame, wants_any, status, rows, memory):
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
    status : ndarray of shape (N,), uint8
    rows : HitArrays
        Of the nearest hits; or with a `prim_id` that becomes 1 for a ray with any hit, else 0.
    memory : tuple of two uint64
        See `queries.Searches`.
    """
    group, lanes = Float64Group(at), Float64Lanes(at)
    is_usual = count == _LANES and not any_lane(group.state != np.int32(0))
    if is_usual and wants_any:
        bits, to = mask_bits(group.prim_id != NO_PRIM), address(rows.prim_id) + first
        for k in range(_LANES):
            store(to + k, np.uint8((bits >> k) & ONE_U64))
        return
    if not is_usual:
        for k in range(count):
            _finish_one(lanes, k, first + k, tree, frame, wants_any, status, rows, memory)
        return
    left = _finish_all(group, first, tree, rows)
    while left != ZERO_U64:
        k = count_trailing_zeros(left)
        left &= left - ONE_U64
        _finish_one(lanes, k, first + k, tree, frame, False, status, rows, memory)
