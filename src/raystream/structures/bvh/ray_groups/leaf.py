"""Leaves of `walks.groups`: triangles against groups of 16 rays, and against single rays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    f64x16,
    load,
    mask_bits,
    store,
)
from raystream.jit.views import address_of, view
from raystream.kernels.best import Best, best_views, offer_hits, offer_lanes
from raystream.kernels.leaf_block import BLOCK, HITS, Block, BlockLanes, HitLanes
from raystream.kernels.triangle_lanes import (
    distance_along,
    extents,
    intersect_lanes,
    plane_normal,
    shear_vertices,
    signs_agree,
)
from raystream.structures.bvh.node_layout import LANE, leaf_address, leaf_end
from raystream.structures.bvh.packets.filters import lanes_filter, ray_filter
from raystream.structures.bvh.packets.leaf import vertices
from raystream.structures.bvh.packets.rays import GROUP, Group, GroupLanes, in_all_lanes, three
from raystream.structures.bvh.ray_groups.rays import (
    COLD_AT,
    GROUP_SHIFT,
    HITS_AT,
    HOT_AT,
    LANE_SHIFT,
    LAST_LANE,
    Cold,
    Hot,
    axis_kinds,
    copy_limits,
    in_frame,
    interval,
)

_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_FIRST, _SECOND, _THIRD = np.uint64(0), np.uint64(1), np.uint64(2)
_BLOCK_LANES = np.uint64(4)

#: Children of a node and their lists; hits of a block; normals of its triangles.
_ROWS: list[tuple[str, str, tuple[int, ...]]] = [
    *((name, "u8", (8,)) for name in ("list", "count", "ray_count")),
    ("normal", "f8", (3, 4)),
    ("t_in", "f4", (8,)),
    ("keys", "i4", (8,)),
]
_OTHERS = [("hits", HITS), ("unused", "V48")]
_SMALL = np.dtype([*_ROWS, *_OTHERS])
Small = view(_SMALL)
SmallLanes = view([*((name, kind, (*shape, 1)) for name, kind, shape in _ROWS), *_OTHERS])
SMALL_BYTES = _SMALL.itemsize


@device
def _corner_in_frame(is_y, is_z, corners, corner, lane):
    x, y, z = corners[corner, _X, lane], corners[corner, _Y, lane], corners[corner, _Z, lane]
    return in_frame(is_y, is_z, *in_all_lanes(x, y, z))


@device
def _extent_of(corners, axis, lane):
    a, b, c = corners[_FIRST, axis, lane], corners[_SECOND, axis, lane], corners[_THIRD, axis, lane]
    return min(min(a, b), c), max(max(a, b), c)


@device
def _write_normals(block, small):
    normal = small.normal
    normal[_X], normal[_Y], normal[_Z] = plane_normal(*vertices(block, _X, _Y, _Z))


@device
def _axes(hot):
    kx, ky, kz = hot.axes
    return np.uint64(kx), np.uint64(ky), np.uint64(kz)


@device
def _sheared(hot, cold, block):
    """The vertices of a block's four triangles in a ray's frame."""
    return shear_vertices(*vertices(block, *_axes(hot)), hot.origin, (hot.sx, cold.sy))


@device
def _distances(hot, cold, block, small):
    """Distances of a ray to the planes of four triangles."""
    x, y, z = _axes(hot)
    corners, normal = block.corners, small.normal
    a = corners[_FIRST, x], corners[_FIRST, y], corners[_FIRST, z]
    n = normal[x], normal[y], normal[z]
    return distance_along(a, n, hot.origin, cold.direction)


class GroupLeaf(NamedTuple):
    """Leaves of triangles whose nearest, or any, hits are kept; see `walks.groups.trace_block`.

    Attributes
    ----------
    visit : device function
    lanes_best, ray_best : device function
        ``lanes_best(leaf, memory, g)`` is the `Best` of a group, and ``ray_best(leaf, memory, g,
        k)`` that of its ray k. A ray's limit is its `t`.
    wants_any : bool
    given : NamedTuple or None
        What the functions need besides.
    """

    visit: Any
    lanes_best: Any
    ray_best: Any
    wants_any: bool
    given: Any


@device
def _keep_lanes(taken, t, u, v, leaf, memory, g, prim_id):
    """Keep hits of a group with a triangle; returns 1 if there was a nearer one, else 0."""
    bits = offer_lanes(leaf.lanes_best(leaf, memory, g), taken, t, u, v, prim_id)
    copy_limits(memory, g, bits)
    return np.uint64(bits != ZERO_U64)


@device
def _keep_hits(taken, t, u, v, leaf, memory, number, block, found):
    """Keep the nearest of a ray's hit and those of some triangles; returns 1 if any is hit."""
    bits = mask_bits(taken)
    if bits == ZERO_U64:
        return ZERO_U64
    found.t, found.u, found.v = t, u, v
    g, k, lanes = number >> LANE_SHIFT, number & LAST_LANE, HitLanes(address_of(found))
    if offer_hits(leaf.ray_best(leaf, memory, g, k), k, bits, lanes, block.prim_ids):
        Hot(memory + HOT_AT, number).t = GroupLanes(memory, g).t[k]
    return ONE_U64


@device
def _group_distance(is_y, is_z, a, normal, lane, group):
    """Distances of a group's rays to the plane of a triangle."""
    n = in_frame(
        is_y,
        is_z,
        f64x16(normal[_X, lane]),
        f64x16(normal[_Y, lane]),
        f64x16(normal[_Z, lane]),
    )
    return distance_along(a, n, three(group.origin), three(group.direction))


@device
def _test_with_group(leaf, g, memory, block, lane, normal):
    """Test a triangle against a group; returns 1 if a ray has a nearer hit, else 0."""
    group = Group(memory, g)
    is_y, is_z = axis_kinds(group)
    corners = block.corners
    a = _corner_in_frame(is_y, is_z, corners, _FIRST, lane)
    b = _corner_in_frame(is_y, is_z, corners, _SECOND, lane)
    c = _corner_in_frame(is_y, is_z, corners, _THIRD, lane)
    origin, shear = three(group.origin), group.shear
    sheared = shear_vertices(a, b, c, origin, (shear[_X], shear[_Y]))
    # Signs of edge functions first: most triangles of a leaf are missed by all 16 rays.
    candidates = signs_agree(sheared)
    if not any_lane(candidates):
        return ZERO_U64
    low_x, high_x = _extent_of(corners, _X, lane)
    low_y, high_y = _extent_of(corners, _Y, lane)
    low_z, high_z = _extent_of(corners, _Z, lane)
    inv, low, high = three(group.inv), three(group.near), three(group.far)
    corners = in_all_lanes(low_x, low_y, low_z), in_all_lanes(high_x, high_y, high_z)
    box = interval(corners, inv, low, high)
    limits, plane = (group.t_min, group.t), ((is_y, is_z, a, normal, lane, group), _group_distance)
    then = (leaf, memory, g, block.prim_ids[lane]), _keep_lanes
    return intersect_lanes(sheared, candidates, box, limits, plane, False, then)


@device
def _with_groups(leaf, at, groups, count, memory, small):
    """Test a block against the groups of a list; returns the number of hits."""
    block, normal, hit_count = BlockLanes(at), SmallLanes(address_of(small)).normal, ZERO_U64
    _write_normals(Block(at), small)
    for lane in range(_BLOCK_LANES):
        if block.prim_ids[lane] < np.int32(0):
            break
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> GROUP_SHIFT
            hit_count += _test_with_group(leaf, g, memory, block, lane, normal)
    return hit_count


@device
def _with_rays(leaf, block, rays, count, memory, small):
    """Test a block against the rays of a list; returns the number of hits."""
    # Step 1: compact the rays whose edge functions agree in sign, without branches. (With one
    # per ray, mispredictions would take half the time of a leaf.)
    hots, colds, hits = memory + HOT_AT, memory + COLD_AT, memory + HITS_AT
    candidate_count = ZERO_U64
    for j in range(count):
        number = load(np.uint32, rays + j * LANE)
        hot, cold = Hot(hots, np.uint64(number)), Cold(colds, np.uint64(number))
        store(hits + candidate_count * LANE, number)
        candidate_count += np.uint64(any_lane(signs_agree(_sheared(hot, cold, block))))
    if candidate_count == ZERO_U64:
        return ZERO_U64

    # Step 2: test these exactly, with the normals of the block's planes, which all rays share.
    hit_count = ZERO_U64
    corners = extents(*vertices(block, _X, _Y, _Z))
    _write_normals(block, small)
    for j in range(candidate_count):
        number = np.uint64(load(np.uint32, hits + j * LANE))
        hot, cold = Hot(hots, number), Cold(colds, number)
        box = interval(corners, hot.inv, hot.low, hot.high)
        sheared = _sheared(hot, cold, block)
        signs, limits = signs_agree(sheared), (hot.t_min, hot.t)
        plane = (hot, cold, block, small), _distances
        then = (leaf, memory, number, block, small.hits), _keep_hits
        hit_count += intersect_lanes(sheared, signs, box, limits, plane, False, then)
    return hit_count


@device
def visit_leaf(leaf, tree, child, rays, memory, small):
    """Test a leaf's triangles against the rays that reach it; returns the number of hits.

    Parameters
    ----------
    leaf : GroupLeaf
    tree : NamedTuple
        With the address of its ``leaves``.
    child : int32
        The leaf's link.
    rays : walks.groups.RayList
    memory, small
        See `walks.groups.trace_block`.
    """
    hit_count = ZERO_U64
    block = leaf_address(tree.leaves, child)
    end = leaf_end(block, child)
    while block != end:
        if rays.is_grouped:
            hit_count += _with_groups(leaf, block, rays.at, rays.length, memory, small)
        else:
            hit_count += _with_rays(leaf, Block(block), rays.at, rays.length, memory, small)
        block += BLOCK
    return hit_count


#: A group's limits and hits. The nearest hit so far is the limit of its ray.
_Hits, _HitsLanes = best_views(GROUP, limit="t", t="t")


@device
def _lanes_best(leaf, memory, g):
    at = _Hits(memory, g)
    return Best(at, at, None, lanes_filter(leaf.given, Group(memory, g), g), leaf.wants_any)


@device
def _ray_best(leaf, memory, g, k):
    at, own = _HitsLanes(memory, g), ray_filter(leaf.given, GroupLanes(memory, g), g, k)
    return Best(at, at, None, own, leaf.wants_any)


@device
def nearest_leaf(wants_any, filter_):
    """The leaves of a scene without instances; `filter_` is a `PacketFilter` or None."""
    return GroupLeaf(visit_leaf, _lanes_best, _ray_best, wants_any, filter_)
