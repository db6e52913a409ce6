"""The numbers of hits of groups of rays in float64, and the rays that are traced by themselves."""

from __future__ import annotations

import numpy as np

from raystream.core.query import UNLIMITED
from raystream.core.rays import RayStatus
from raystream.float64.group_rays import ALONE, INVALID, Float64Group, Float64Lanes, exact_ray
from raystream.float64.queries import LANES_BYTES, tree_searches
from raystream.float64.ray import ray_of_line
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.constants import BYTES_64, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import any_lane, count_trailing_zeros, scratch, store
from raystream.structures.bvh.leaf_kinds import CountsLanes

_NONE = np.int32(0)
_UNIT = np.float64(1.0)
_UNLIMITED = np.uint64(UNLIMITED)
_count = tree_searches.count


@device
def rays_alone(rays, g, first, count, status):
    """Bits of the rays of a group that are traced by themselves; reports those that are invalid."""
    bits = ZERO_U64
    if any_lane(Float64Group(rays, g).state != _NONE):
        state = Float64Lanes(rays, g).state
        for k in range(count):
            if state[k] & INVALID:
                store(status + first + k, np.uint8(RayStatus.INVALID))
            bits |= np.uint64(state[k] & ALONE != _NONE) << k
    return bits


@device
def finish_counts(packet, g, rays, first, count, source, scene, wanted):
    """Write the numbers of hits of a group's `count` rays from `first` on.

    Parameters
    ----------
    packet : uint64
        With the numbers that were counted, see `leaf_kinds.Counts`.
    g : uint64
        The group.
    rays : uint64
        See `leaf.Float64Leaf`.
    first, count : uint64
    source : Float64Packets
    scene : Float64Tree
    wanted : packet_queries.CountsWanted
    """
    found, alone = CountsLanes(packet, g).count, rays_alone(rays, g, first, count, source.status)
    while alone != ZERO_U64:
        k = count_trailing_zeros(alone)
        alone &= alone - ONE_U64
        line = exact_ray(Float64Lanes(rays, g), k)
        found[k] = _count_alone(line, source.frame, scene, wanted.surfaces)
    for k in range(count):
        store(wanted.counts + (first + k) * BYTES_64, np.int64(found[k]))


@device_call
def _count_alone(line, frame, scene, surfaces):
    no_inline()
    memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
    ray = ray_of_line(line, _UNIT, _UNIT, np.uint8(0), frame)
    return np.int32(_count(scene, ray, _UNLIMITED, surfaces, memory))
