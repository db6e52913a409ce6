"""Results of groups of rays in float64; rays that are traced by themselves are traced here.

Those are invalid, or too far away for boxes in float32.
"""

from __future__ import annotations

import numpy as np

from raystream.core.rays import VALID
from raystream.geometry.float64.block import AXIS, SECOND, THIRD
from raystream.geometry.float64.exact import estimate
from raystream.geometry.float64.group_rays import Float64Group, Float64Lanes, exact_ray, nearest_of
from raystream.geometry.float64.leaf import search_lane, take_in_lane
from raystream.geometry.float64.queries import write_nearest
from raystream.geometry.float64.ray import Lengths, ray_of_line, reported
from raystream.geometry.float64.search import NO_PRIM
from raystream.geometry.float64.traversal import STACK_BYTES, tree_blocks
from raystream.jit.constants import INF_F64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    any_lane,
    count_trailing_zeros,
    f64x16,
    gather,
    i32x16,
    i64x16,
    mask_bits,
    scratch,
    select,
    store,
)
from raystream.structures.bvh.packets.rays import three

_LANES = np.uint64(16)
_NO_TRIANGLE, _SHIFT64 = np.int64(0), np.int64(3)
_MISS = np.int32(-1)

_walk = tree_blocks(take_in_lane)


@device_call
def _trace_one(leaf, packet, g, k, frame, tree):
    no_inline()
    lanes = Float64Lanes(leaf.rays, g)
    lanes.far[k] = lanes.t_max[k]
    line, half, rest = exact_ray(lanes, k), lanes.half[k], lanes.rest[k]
    ray, search = ray_of_line(line, half, rest, VALID, frame), search_lane(leaf, packet, g, k)
    _walk(tree, (ray, leaf.spans, None), search, scratch(STACK_BYTES), False)


@device
def trace_alone(leaf, packet, g, count, frame, tree):
    """Trace those of a group's first `count` rays that are traced by themselves.

    Parameters
    ----------
    leaf : Float64Leaf
        It takes the hits.
    packet : uint64
        The group's packet.
    g, count : uint64
    frame : SceneFrame
    tree : Float64Tree
    """
    alone = mask_bits(Float64Group(leaf.rays, g).is_alone != np.int32(0))
    alone &= (ONE_U64 << count) - ONE_U64  # further lanes repeat the last ray
    while alone != ZERO_U64:
        k = count_trailing_zeros(alone)
        alone &= alone - ONE_U64
        _trace_one(leaf, packet, g, k, frame, tree)


# The nearest or any hits


@device
def _gather_corner(at, index):
    x, y = gather(np.float64, at, index), gather(np.float64, at + AXIS, index)
    return x, y, gather(np.float64, at + (AXIS + AXIS), index)


@device
def _store_lanes(group, first, tree, out):
    """Write the nearest hits of 16 rays; returns bits of those in doubt."""
    triangle, at = group.triangle, first << SHIFT_64
    is_hit, zero = triangle != _NO_TRIANGLE, f64x16(ZERO_F64)
    t_at, u_at, v_at = out.t + at, out.u + at, out.v + at
    prim_id = select(is_hit, group.prim_id, i32x16(_MISS))
    store(out.prim_id + (first << SHIFT_32), prim_id)
    if not any_lane(is_hit):
        store(t_at, f64x16(INF_F64))
        store(u_at, zero)
        store(v_at, zero)
        return ZERO_U64
    index = select(is_hit, (triangle - np.int64(tree.leaves)) >> _SHIFT64, i64x16(_NO_TRIANGLE))
    hit = estimate(
        _gather_corner(tree.leaves, index),
        _gather_corner(tree.leaves + SECOND, index),
        _gather_corner(tree.leaves + THIRD, index),
        three(group.origin),
        three(group.direction),
    )
    store(t_at, select(is_hit, reported(hit.t, group), f64x16(INF_F64)))
    store(u_at, select(is_hit, hit.u, zero))
    store(v_at, select(is_hit, hit.v, zero))
    return mask_bits(is_hit) & ~mask_bits(hit.is_known)


@device_call
def _store_one(lanes, k, i, out):
    """Write the nearest hit of ray i."""
    no_inline()
    lengths = Lengths(lanes.half[k], lanes.rest[k])
    write_nearest(out, i, nearest_of(lanes, k), exact_ray(lanes, k), lengths)


@device
def store_nearest(leaf, packet, g, first, count, tree, wanted):
    """Write the nearest or any hits of a group's `count` rays from `first` on.

    Parameters
    ----------
    leaf : Float64Leaf
    packet, g, first, count : uint64
    tree : Float64Tree
    wanted : packets.queries.NearestWanted
        Its hits are of float64.
    """
    group, lanes, out = Float64Group(leaf.rays, g), Float64Lanes(leaf.rays, g), wanted.out
    if wanted.wants_any:
        bits = mask_bits(group.prim_id != NO_PRIM)
        for k in range(count):
            store(out.seen + first + k, np.uint8((bits >> k) & ONE_U64))
        return
    left = (ONE_U64 << count) - ONE_U64
    if count == _LANES:
        left = _store_lanes(group, first, tree, out)
    while left != ZERO_U64:
        k = count_trailing_zeros(left)
        left &= left - ONE_U64
        _store_one(lanes, k, first + k, out)
