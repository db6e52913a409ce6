"""The nearest hits of rays that are traced together in float64, and the rule by which one is kept.

As `kernels.best`, with intervals of distances in place of numbers. Most hits are told apart by
these, 16 at a time: `offer_lanes`. Those in doubt are decided one by one, by exact arithmetic:
`offer_one`, with `search.offer`.
"""

from __future__ import annotations

import numpy as np

from raystream.geometry.float64.filters import filter_of_lane, kept_span
from raystream.geometry.float64.group_rays import Float64Group, Float64Lanes, nearest_of
from raystream.geometry.float64.search import exists, offer, within
from raystream.jit.constants import INF_F32, INF_F64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    f32x16,
    f64x16,
    i32x16,
    i64x16,
    mask_bits,
    narrow_lanes,
    select,
)
from raystream.jit.views import view
from raystream.structures.bvh.packets.rays import GROUP

_Limits = view([("limit", "f4", 16)])
_LimitLanes = view([("limit", "f4", (16, 1))])

_LOCAL_BYTES = np.uint64(GROUP.itemsize)

#: Limits are rounded up by this part of the offset, whose own rounding it covers, then by more
#: than a step of float32, as a part of a number, and near 0.
_OFFSET_SLACK = 2.0**-50
_STEPS, _LEAST_STEP = np.float32(2.0**-22), np.float32(2.0**-126)


@device
def _limit(far, scale, offset):
    """The end of an interval in the tree's space, rounded up; of numbers, or of vectors."""
    limit = narrow_lanes(far * scale - offset + absolute(offset) * _OFFSET_SLACK)
    return limit + absolute(limit) * _STEPS + _LEAST_STEP


@device
def _limits_of(leaf, packet, g):
    """Address of the ends of the intervals of a group's rays in the tree's space, rounded up."""
    return packet + g * _LOCAL_BYTES + leaf.limits_at


@device
def certain_hits(group, hits):
    """The mask of the `PossibleHits` of a group that are in their rays' intervals for sure."""
    return hits.found & hits.sure & within(group, hits.low, hits.high)


@device
def offer_lanes(leaf, packet, g, hits, triangle, prim_id):
    """Keep hits of a group that are before those kept so far, for sure; see `leaf.Kind`."""
    group = Float64Group(leaf.rays, g)
    nearest = group.low
    # Their digits do not matter.
    taken = certain_hits(group, hits) & (hits.high < nearest)
    bits = mask_bits(taken)
    if bits != ZERO_U64:
        group.prim_id = select(taken, i32x16(prim_id), group.prim_id)
        limit = f32x16(-INF_F32)
        if leaf.kind.wants_any:
            group.far = select(taken, f64x16(-INF_F64), group.far)
        else:
            group.low = select(taken, hits.low, nearest)
            group.high = select(taken, hits.high, group.high)
            group.triangle = select(taken, i64x16(np.int64(triangle)), group.triangle)
            group.far = select(taken, hits.high, group.far)
            limit = _limit(hits.high, group.scale, group.offset)
        limits = _Limits(_limits_of(leaf, packet, g))
        limits.limit = select(taken, limit, limits.limit)
    return bits, bits


@device
def offer_one(leaf, packet, g, k, line, span, triangle, prim_id):
    """Keep a hit of ray k that is in doubt; see `leaf.Kind`."""
    lanes, limits = Float64Lanes(leaf.rays, g), _LimitLanes(_limits_of(leaf, packet, g)).limit
    own = filter_of_lane(leaf.kind.filter, lanes, g, k)
    is_kept, span = kept_span(own, line, span, triangle, prim_id, False)
    if not is_kept:
        return
    if leaf.kind.wants_any:
        if exists(line, span, triangle, False):
            lanes.prim_id[k], lanes.far[k], limits[k] = prim_id, -INF_F64, -INF_F32
        return
    old = nearest_of(lanes, k)
    new = offer(line, old, span, triangle, prim_id)
    if new.triangle != old.triangle or new.t_far != old.t_far:
        lanes.low[k], lanes.high[k], lanes.far[k] = new.low, new.t_far, new.t_far
        lanes.triangle[k], lanes.prim_id[k] = np.int64(new.triangle), new.prim_id
        limits[k] = np.float32(_limit(new.t_far, lanes.scale[k], lanes.offset[k]))
