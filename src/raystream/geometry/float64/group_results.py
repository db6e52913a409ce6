"""Results of groups of rays in float64; rays that are traced by themselves are traced here.

Those are invalid, or too far away for boxes in float32.
"""

from __future__ import annotations

import numpy as np

from raystream.core.query import UNLIMITED
from raystream.geometry.float64.block import SECOND, THIRD
from raystream.geometry.float64.exact import barycentrics, estimate
from raystream.geometry.float64.group_rays import Float64Group, Float64Lanes, exact_ray, nearest_of
from raystream.geometry.float64.queries import MEMORY_BYTES, float64_searches, write_nearest
from raystream.geometry.float64.ray import ray_of_line, reported
from raystream.geometry.float64.search import NO_PRIM
from raystream.geometry.float64.traversal import tree_blocks
from raystream.jit.constants import BYTES_64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
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
from raystream.kernels.queries import RayScene
from raystream.kernels.search import SearchGoal
from raystream.structures.bvh.leaf_kinds import CountsLanes
from raystream.structures.bvh.packets.rays import three

_LANES = np.uint64(16)
_UNLIMITED = np.uint64(UNLIMITED)
_INF, _ZERO = np.float64(np.inf), np.float64(0.0)
_NO_TRIANGLE, _SHIFT64 = np.int64(0), np.int64(3)
_NONE, _MISS = np.int32(0), np.int32(-1)

_nearest, _count, _, _ = float64_searches(tree_blocks)


@device
def rays_alone(rays, g):
    """Bits of the rays of a group that are traced by themselves."""
    return mask_bits(Float64Group(rays, g).is_alone != _NONE)


@device
def _single(source, tree):
    """The rays as single ones."""
    return RayScene(source.exact, source.frame, tree, source.status, None, None)


# The nearest or any hits


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
def _store_lanes(group, first, tree, out):
    """Write the nearest hits of 16 rays; returns bits of those in doubt."""
    triangle, at = group.triangle, first << SHIFT_64
    is_hit, zero = triangle != _NO_TRIANGLE, f64x16(_ZERO)
    t_at, u_at, v_at = out.t + at, out.u + at, out.v + at
    prim_id = select(is_hit, group.prim_id, i32x16(_MISS))
    store(out.prim_id + (first << SHIFT_32), prim_id)
    if not any_lane(is_hit):
        store(t_at, f64x16(_INF))
        store(u_at, zero)
        store(v_at, zero)
        return ZERO_U64
    index = select(is_hit, (triangle - np.int64(tree.leaves)) >> _SHIFT64, i64x16(_NO_TRIANGLE))
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
def _store_one(lanes, k, i, source, tree, wanted):
    """Write the result of ray i."""
    no_inline()
    scene, memory = _single(source, tree), scratch(MEMORY_BYTES)
    is_alone = lanes.is_alone[k] != _NONE
    if wanted.wants_any:
        is_hit = lanes.prim_id[k] != NO_PRIM
        if is_alone:
            is_hit = _count(i, scene, _goal(ONE_U64, False), memory) != ZERO_U64
        store(wanted.out.seen + i, np.uint8(is_hit))
    elif is_alone:
        _nearest(i, scene, wanted.out, memory)
    else:
        line, half, rest = exact_ray(lanes, k), lanes.half[k], lanes.rest[k]
        ray = ray_of_line(line, half, rest, np.uint8(0), source.frame)
        write_nearest(wanted.out, i, nearest_of(lanes, k), ray)


@device
def store_nearest(packet, g, rays, first, count, source, tree, wanted):
    """Write the nearest or any hits of a group's `count` rays from `first` on.

    Parameters
    ----------
    packet : uint64
        The group's packet.
    g : uint64
        The group.
    rays : uint64
        See `leaf.Float64Leaf`.
    first, count : uint64
    source : Float64Packets
    tree : Float64Tree
    wanted : packets.queries.NearestWanted
        Its hits are of float64.
    """
    group, lanes, out = Float64Group(rays, g), Float64Lanes(rays, g), wanted.out
    if count != _LANES or rays_alone(rays, g) != ZERO_U64:
        for k in range(count):
            _store_one(lanes, k, first + k, source, tree, wanted)
    elif wanted.wants_any:
        bits = mask_bits(group.prim_id != NO_PRIM)
        for k in range(_LANES):
            store(out.seen + first + k, np.uint8((bits >> k) & ONE_U64))
    else:
        left = _store_lanes(group, first, tree, out)
        while left != ZERO_U64:
            k = count_trailing_zeros(left)
            left &= left - ONE_U64
            _store_one(lanes, k, first + k, source, tree, wanted)


# The numbers of hits


@device
def _goal(capacity, surfaces):
    return SearchGoal(capacity, None, ZERO_U64, surfaces)


@device_call
def _count_alone(i, source, tree, surfaces):
    no_inline()
    goal, memory = _goal(_UNLIMITED, surfaces), scratch(MEMORY_BYTES)
    return np.int32(_count(i, _single(source, tree), goal, memory))


@device
def store_counts(packet, g, rays, first, count, source, tree, wanted):
    """Write numbers of hits, see `leaf_kinds.Counts`, for a `packets.multi_hit.RowsWanted`."""
    found, alone = CountsLanes(packet, g).count, rays_alone(rays, g)
    for k in range(count):
        if (alone >> k) & ONE_U64 != ZERO_U64:
            found[k] = _count_alone(first + k, source, tree, wanted.surfaces)
        store(wanted.counts + (first + k) * BYTES_64, np.int64(found[k]))
