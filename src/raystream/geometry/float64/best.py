"""The nearest hits of rays that are traced together in float64, and the rule by which one is kept.

As `kernels.best`, with intervals of distances in place of numbers. Most hits are told apart by
these, 16 at a time; those in doubt are decided one by one, by exact arithmetic: `search.offer`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.float64.block import HIGH, PRIM_IDS, span_of
from raystream.geometry.float64.group_rays import Float64Group, Float64Lanes, exact_ray, nearest_of
from raystream.geometry.float64.search import exists, offer
from raystream.jit.constants import INF_F32, INF_F64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    count_trailing_zeros,
    f32x16,
    f64x16,
    i32x16,
    i64x16,
    load,
    mask_bits,
    narrow_lanes,
    select,
    store,
)
from raystream.jit.views import view

_Limits = view([("limit", "f4", 16)])
_LimitLanes = view([("limit", "f4", (16, 1))])

#: Bytes of `Float64Best.spans`: the least distances, and behind them the largest ones.
SPAN_BYTES = 256
_LANES_HIGH = np.uint64(128)

#: Limits are rounded up by this part of the offset, whose own rounding it covers, then by more
#: than a step of float32, as a part of a number, and near 0.
_OFFSET_SLACK = 2.0**-50
_STEPS, _LEAST_STEP = np.float32(2.0**-22), np.float32(2.0**-126)


class Float64Best(NamedTuple):
    """Where the nearest hits of 16 rays so far are.

    Attributes
    ----------
    rays : uint64
        Address of the rays and their hits, `group_rays.FLOAT64_GROUP`.
    limits : uint64
        Address of 16 float32: the ends of the rays' intervals in the tree's space, rounded up.
    spans : uint64
        Address of `SPAN_BYTES` bytes for the intervals of hits in doubt.
    wants_any : bool
        Any hit ends the search of its ray.
    """

    rays: np.uint64
    limits: np.uint64
    spans: np.uint64
    wants_any: bool


@device
def _limit(far, scale, offset):
    """The end of an interval in the tree's space, rounded up; of numbers, or of vectors."""
    limit = narrow_lanes(far * scale - offset + absolute(offset) * _OFFSET_SLACK)
    return limit + absolute(limit) * _STEPS + _LEAST_STEP


@device
def _offer_one(best, k, span, triangle, prim_id):
    """Offer ray k a triangle that it may hit; returns whether that is kept."""
    lanes, limits = Float64Lanes(best.rays), _LimitLanes(best.limits).limit
    line = exact_ray(lanes, k)
    if best.wants_any:
        if not exists(line, span, triangle, False):
            return False
        lanes.prim_id[k], lanes.far[k], limits[k] = prim_id, -INF_F64, -INF_F32
        return True
    old = nearest_of(lanes, k)
    new = offer(line, old, span, triangle, prim_id)
    if new.triangle == old.triangle and new.high == old.high:
        return False
    far = min(new.high, line.t_max)
    lanes.low[k], lanes.high[k], lanes.far[k] = new.low, new.high, far
    lanes.triangle[k], lanes.prim_id[k] = np.int64(new.triangle), new.prim_id
    limits[k] = np.float32(_limit(far, lanes.scale[k], lanes.offset[k]))
    return True


@device
def certain_hits(group, hits):
    """The mask of the `PossibleHits` of a group that are in their rays' intervals for sure."""
    is_within = (hits.low >= group.t_min) & (hits.high <= group.t_max)
    return hits.found & hits.sure & is_within


@device
def offer_lanes(best, hits, triangle, prim_id):
    """Offer 16 rays a triangle.

    Parameters
    ----------
    best : Float64Best
    hits : PossibleHits
    triangle : uint64
        The triangle's address.
    prim_id : int32

    Returns
    -------
    uint64
        Bits of the rays whose intervals became shorter.
    """
    group, nearest = Float64Group(best.rays), Float64Group(best.rays).low
    # Step 1: hits before the one kept so far, for sure. Their digits do not matter.
    taken = certain_hits(group, hits) & (hits.high < nearest)
    bits = mask_bits(taken)
    if bits != ZERO_U64:
        group.prim_id = select(taken, i32x16(prim_id), group.prim_id)
        limit = f32x16(-INF_F32)
        if best.wants_any:
            group.far = select(taken, f64x16(-INF_F64), group.far)
        else:
            group.low = select(taken, hits.low, nearest)
            group.high = select(taken, hits.high, group.high)
            group.triangle = select(taken, i64x16(np.int64(triangle)), group.triangle)
            group.far = select(taken, hits.high, group.far)
            limit = _limit(hits.high, group.scale, group.offset)
        limits = _Limits(best.limits)
        limits.limit = select(taken, limit, limits.limit)
    # Step 2: the others one by one. They are few: rays near edges, at equal distances, or behind
    # the hit kept so far by less than its interval.
    sure, doubtful = mask_bits(hits.sure), mask_bits(hits.found) & ~bits
    if doubtful != ZERO_U64:
        store(best.spans, hits.low)
        store(best.spans + _LANES_HIGH, hits.high)
    while doubtful != ZERO_U64:
        k = count_trailing_zeros(doubtful)
        doubtful &= doubtful - ONE_U64
        if _offer_one(best, k, span_of(best.spans, _LANES_HIGH, k, sure), triangle, prim_id):
            bits |= ONE_U64 << k
    return bits


@device
def offer_hits(best, k, found, sure, block):
    """Offer a ray some triangles of a block; returns whether one of them is kept.

    Parameters
    ----------
    best : Float64Best
        Its `spans` are as `block.test_ray` wrote them.
    k : uint64
        The ray's lane.
    found, sure : uint64
        See `block.test_ray`.
    block : uint64
    """
    is_kept = False
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        span, triangle = span_of(best.spans, HIGH, lane, sure), block + (lane << SHIFT_64)
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        if _offer_one(best, k, span, triangle, prim_id):
            is_kept = True
            if best.wants_any:
                break
    return is_kept
