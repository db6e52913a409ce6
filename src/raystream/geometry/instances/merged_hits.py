"""Groups of 16 rays in an instance, and the hits of a scene's groups, merged from its instances.

Hits have their t as it is reported, and the numbers of the scene's triangles: see `kernels.best`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import NULL, ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    float_as_bits,
    lanes_from_bits,
    load,
    mask16,
    mask_bits,
    scratch,
    store,
)
from raystream.kernels.best import Best, LanesFilter, best_views, shorten_ray
from raystream.kernels.hit_filter import (
    FILTERED_BYTES,
    U_AT,
    V_AT,
    HitFilter,
    RayFilter,
    asks_at_hits,
    keeps,
)
from raystream.kernels.masks import has_bit, lanes_with_bit
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packets.rays import GROUP, GroupPlaces, first_ray
from raystream.structures.bvh.ray_groups.leaf import GroupLeaf, visit_leaf
from raystream.structures.bvh.ray_groups.rays import (
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LAST_LANE,
    PLACES_AT,
    RAY_BITS,
    Hot,
)

#: A group in a scene or an instance, see `kernels.best`; `before` has the bits of the numbers of
#: the triangles that were hit before this instance.
Merged, MergedLanes = best_views(
    GROUP,
    limit="t",
    t="t_active",
    t_scale="slow_t_scale",
    t_offset="slow_t_offset",
    before="t_scale",
)


class InstanceList(NamedTuple):
    """A list of a scene's rays in an instance: what keeps their hits needs.

    Attributes
    ----------
    first_id : int32
        See `kernels.best.Best`.
    filter : HitFilter or None
    scene : uint64
        Memory of the scene's groups.
    rays, last : uint64
        Address of the numbers of these rays in the scene, and the last one's index.
    """

    first_id: np.int32
    filter: HitFilter | None
    scene: np.uint64
    rays: np.uint64
    last: np.uint64


@device
def ray_index(scene, number):
    """The index in the batch of a ray of a scene's groups."""
    places = GroupPlaces(scene + PLACES_AT, ZERO_U64, ZERO_U64)
    return first_ray(places, number >> LANE_SHIFT) + (number & LAST_LANE)


@device
def admitted_rays(filter_, mask, scene, rays):
    """Remove those of a `RayList` that cannot hit what has a mask; returns its new length.

    `filter_` is a `HitFilter` or None. Groups without rays remain in a list of groups.
    """
    if filter_ is None:
        return rays.length
    if filter_.entered == NULL:
        return rays.length
    kept = ZERO_U64
    for j in range(rays.length):
        number = np.uint64(load(np.uint32, rays.at + j * LANE))
        if rays.is_grouped:
            first = ray_index(scene, number >> GROUP_SHIFT << LANE_SHIFT)
            number &= ~RAY_BITS | mask_bits(lanes_with_bit(filter_.entered, first, mask))
            is_kept = True
        else:
            is_kept = has_bit(filter_.entered, ray_index(scene, number), mask)
        store(rays.at + kept * LANE, np.uint32(number))
        kept += np.uint64(is_kept)
    return kept


@device
def _ray_filter(filter_, rays, memory, g, k):
    """The `RayFilter` of a ray of an `InstanceList`; None without a filter."""
    if filter_ is None:
        return None
    at = min((g << LANE_SHIFT) | k, rays.last)  # groups are filled with copies of the last ray
    i = ray_index(rays.scene, np.uint64(load(np.uint32, rays.rays + at * LANE)))
    lanes = MergedLanes(memory, g)
    return RayFilter(filter_, i, lanes.t_scale[k], lanes.t_offset[k])


@device
def _lanes_filter(filter_, rays, memory, g):
    if filter_ is None:
        return None
    return LanesFilter(_kept_singly, rays, memory, g)


@device
def _kept_singly(rays, taken, t, u, v, number, memory, g):
    """The lanes whose hits exist, asked ray by ray: their indices do not follow each other."""
    if not asks_at_hits(rays.filter):
        return taken
    hits, bits, kept = scratch(FILTERED_BYTES), mask_bits(taken), ZERO_U64
    store(hits, t)
    store(hits + U_AT, u)
    store(hits + V_AT, v)
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        own, at = _ray_filter(rays.filter, rays, memory, g, k), hits + (k << SHIFT_32)
        t_of, u_of = load(np.float32, at), load(np.float32, at + U_AT)
        if keeps(own, t_of, u_of, load(np.float32, at + V_AT), number):
            kept |= ONE_U64 << k
    return lanes_from_bits(mask16, kept)


@device
def _lanes_best(leaf, memory, g):
    rays, at = leaf.given, Merged(memory, g)
    return Best(at, at, rays.first_id, _lanes_filter(rays.filter, rays, memory, g), leaf.wants_any)


@device
def _ray_best(leaf, memory, g, k):
    rays, at = leaf.given, MergedLanes(memory, g)
    own = _ray_filter(rays.filter, rays, memory, g, k)
    return Best(at, at, rays.first_id, own, leaf.wants_any)


@device
def object_leaf(wants_any, rays):
    """The leaves of the object of an instance, for an `InstanceList`."""
    return GroupLeaf(visit_leaf, _lanes_best, _ray_best, wants_any, rays)


@device
def merge_hits(scene, inside, rays, count, first_id, wants_any):
    """Merge the hits of an instance's rays with those of the scene's; returns their number.

    Parameters
    ----------
    scene, inside : uint64
        Memory of the groups in the scene and in the instance's object.
    rays : uint64
        Address of the numbers of these rays in the scene.
    count : uint64
    first_id : int32
        See `kernels.best.Best`.
    wants_any : bool
    """
    hit_count = ZERO_U64
    for g in range((count + LAST_LANE) >> LANE_SHIFT):
        group, lanes = Merged(inside, g), MergedLanes(inside, g)
        bits = mask_bits(group.prim_id != float_as_bits(group.before))
        while bits != ZERO_U64:
            k = count_trailing_zeros(bits)
            bits &= bits - ONE_U64
            at = (g << LANE_SHIFT) | k
            if at >= count:  # a copy of the last ray
                break
            hit_count += ONE_U64
            number = np.uint64(load(np.uint32, rays + at * LANE))
            to, own, t = MergedLanes(scene, number >> LANE_SHIFT), number & LAST_LANE, lanes.t[k]
            to.prim_id[own] = lanes.prim_id[k]
            if not wants_any:
                to.t[own], to.u[own], to.v[own] = t, lanes.u[k], lanes.v[k]
            shorten_ray(first_id, to, own, t, wants_any)
            Hot(scene + HOT_AT, number).t = to.limit[own]
    return hit_count
