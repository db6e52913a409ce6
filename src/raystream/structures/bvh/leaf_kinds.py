"""Kinds of leaves of triangles, for packets: what becomes of their hits.

The nearest or any hits are kept, or all are counted or collected. A leaf is made for a scene
without instances; `leaf_within` makes that of an instance's object, whose rays' hits are those of
the scene's packet.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import count_trailing_zeros, i32x16, load, select
from raystream.jit.views import address_of, view
from raystream.kernels.best import (
    Best,
    best_views,
    offer_hits,
    offer_lanes,
    reported_hit,
    reported_lanes,
)
from raystream.kernels.ray import world_t
from raystream.structures.bvh.node_layout import prefetch_child
from raystream.structures.bvh.packets.filters import all_slow, lanes_filter, ray_filter
from raystream.structures.bvh.packets.hits import collect, collect_one
from raystream.structures.bvh.packets.leaf import Kind, TriangleLeaf, visit_leaf
from raystream.structures.bvh.packets.rays import GROUP, Group, GroupLanes, world_lanes

#: A group's limits and hits, see `kernels.best`. Without instances, the nearest hit so far is the
#: limit of its ray; with them, it is the reported one, in the scene's packet.
_Hits, _HitsLanes = best_views(GROUP, limit="t_active", t="t_active")
InstanceHits, _InstanceHitsLanes = best_views(
    GROUP, limit="t_active", t="t_scale", t_scale="slow_t_scale", t_offset="slow_t_offset"
)

#: The numbers of hits of a group's rays, which have no u.
_U_AT = GROUP.fields["u"][1]  # type: ignore[index]
_COUNT = {"names": ["count"], "offsets": [_U_AT], "itemsize": GROUP.itemsize}
Counts = view({**_COUNT, "formats": [("i4", 16)]})
CountsLanes = view({**_COUNT, "formats": [("i4", (16, 1))]})


@device
def scene_group(within, g):
    """The number of a group in the scene's packet."""
    if within is None:
        return g
    return np.uint64(load(np.uint8, within.groups + g))


@device
def _lanes_best(leaf, packet, g):
    at, own = _Hits(packet, g), lanes_filter(leaf.kind.filter, Group(packet, g), g)
    return Best(at, at, None, own, leaf.kind.wants_any)


@device
def _ray_best(leaf, packet, g, k):
    at, own = _HitsLanes(packet, g), ray_filter(leaf.kind.filter, GroupLanes(packet, g), g, k)
    return Best(at, at, None, own, leaf.kind.wants_any)


@device
def _lanes_best_within(leaf, packet, g):
    within, to = leaf.within, scene_group(leaf.within, g)
    own = lanes_filter(all_slow(leaf.kind.filter), Group(packet, g), to)
    ray, hit = InstanceHits(packet, g), InstanceHits(within.scene, to)
    return Best(ray, hit, within.first_id, own, leaf.kind.wants_any)


@device
def _ray_best_within(leaf, packet, g, k):
    within, to = leaf.within, scene_group(leaf.within, g)
    own = ray_filter(all_slow(leaf.kind.filter), GroupLanes(packet, g), to, k)
    ray, hit = _InstanceHitsLanes(packet, g), _InstanceHitsLanes(within.scene, to)
    return Best(ray, hit, within.first_id, own, leaf.kind.wants_any)


@device
def _keep_lanes(leaf, packet, g, taken, t, u, v, prim_id):
    return offer_lanes(leaf.lanes_best(leaf, packet, g), taken, t, u, v, prim_id) != ZERO_U64


@device
def _keep_hits(leaf, packet, g, k, bits, found, prim_ids):
    return offer_hits(leaf.ray_best(leaf, packet, g, k), k, bits, found, prim_ids)


@device
def _take_lanes(leaf, packet, g, taken, t, u, v, prim_id):
    best, collector = leaf.lanes_best(leaf, packet, g), leaf.kind.collector
    taken, t, number = reported_lanes(best, taken, t, u, v, prim_id)
    if collector.is_counting != ZERO_U64:
        counts = Counts(address_of(best.hit))
        counts.count = select(taken, counts.count + np.int32(1), counts.count)
        return False
    t = _collected(leaf.within, collector, t, Group(packet, g))
    collect(collector, taken, t, u, v, i32x16(number), scene_group(leaf.within, g))
    return False


@device
def _collected(within, collector, t, group):
    """Reported distances as they are collected: in world space, unless that is done later."""
    if within is not None or collector.in_world == ZERO_U64:
        return t
    return world_lanes(t, group.t_scale)


@device
def _collected_one(within, collector, t, t_scale):
    if within is not None or collector.in_world == ZERO_U64:
        return t
    return world_t(t, np.float64(t_scale), np.float64(0.0))


@device
def _take_hits(leaf, packet, g, k, bits, found, prim_ids):
    best, collector = leaf.ray_best(leaf, packet, g, k), leaf.kind.collector
    counts = CountsLanes(address_of(best.hit)).count
    to, lanes = scene_group(leaf.within, g), GroupLanes(packet, g)
    while bits != ZERO_U64:
        lane = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        t, u, v = found.t[lane], found.u[lane], found.v[lane]
        taken, t, number = reported_hit(best, k, t, u, v, prim_ids[lane])
        if collector.is_counting != ZERO_U64:
            counts[k] = np.int32(counts[k] + np.int32(taken))
        elif taken:
            t = _collected_one(leaf.within, collector, t, lanes.t_scale[k])
            collect_one(collector, t, u, v, number, to, k)
    return False


@device
def no_prefetch(child, nodes, leaves):
    """The `prefetch` of leaves of trees in the cache; see `walks.packet.trace_packet`."""


@device
def nearest_leaf(wants_any, filter_):
    """Leaves whose nearest, or any, hits are kept."""
    return _plain_leaf(Kind(_keep_lanes, _keep_hits, False, wants_any, filter_, None))


@device
def collecting_leaf(surfaces, filter_, collector):
    """Leaves whose hits are all collected; or counted, see `Counts`."""
    return _plain_leaf(Kind(_take_lanes, _take_hits, surfaces, False, filter_, collector))


@device
def _plain_leaf(kind):
    return TriangleLeaf(visit_leaf, no_prefetch, _lanes_best, _ray_best, None, kind)


@device
def leaf_within(kind, within):
    """Leaves of the object of an instance."""
    best_of_lanes, best_of_ray = _lanes_best_within, _ray_best_within
    return TriangleLeaf(visit_leaf, prefetch_child, best_of_lanes, best_of_ray, within, kind)
