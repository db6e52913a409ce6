"""Test groups of a packet, 16 rays, against boxes and triangles."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    count_trailing_zeros,
    mask_bits,
    maximum,
    minimum,
    popcount,
)
from raystream.jit.views import address_of, view
from raystream.kernels.leaf_block import (
    AXIS,
    BLOCK,
    HITS,
    Block,
    BlockLanes,
    BlockRay,
    HitLanes,
    test_block,
)
from raystream.kernels.triangle_lanes import (
    extents,
    intersect_lanes,
    plane_distance,
    planes_along,
    shear_vertices,
    signs_agree,
    slab_interval,
)
from raystream.structures.bvh.node_layout import NodeLanes, leaf_address, leaf_end
from raystream.structures.bvh.packets.filters import PacketFilter
from raystream.structures.bvh.packets.rays import Group, GroupLanes, in_all_lanes, three

#: Scratch of a leaf: planes of the boxes of a block's four triangles, by axis, and hits of one ray;
#: and the same with a lane index.
LEAF_SCRATCH = np.dtype([("near", "f4", (3, 4)), ("far", "f4", (3, 4)), ("hits", HITS)])
_ScratchLanes = view([("near", "f4", (3, 4, 1)), ("far", "f4", (3, 4, 1)), ("hits", HITS)])

#: Up to this many rays of a group are tested against four triangles each; more, all 16 at once
#: against one triangle. (Camera and shadow rays on the bunny and in sibenik, one thread of a Zen 4:
#: 1.02 to 1.12 times as fast as never; up to 2, 6 or 9 rays gain less.)
_FEW = np.uint64(4)

_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_FIRST, _SECOND, _THIRD = np.uint64(0), np.uint64(1), np.uint64(2)


class Within(NamedTuple):
    """What the groups in an instance are of the scene's packet, which has their rays' hits.

    Attributes
    ----------
    scene, groups : uint64
        Addresses of the packet, and of the numbers of these groups there, a byte each.
    first_id : int32
        See `kernels.best.Best`.
    """

    scene: np.uint64
    groups: np.uint64
    first_id: np.int32


class Kind(NamedTuple):
    """What becomes of the hits with triangles.

    Attributes
    ----------
    keep_lanes : device function
        ``keep_lanes(leaf, packet, g, taken, t, u, v, prim_id)`` takes the hits of some lanes of a
        group with a triangle; returns whether a ray's search is shorter now.
    keep_hits : device function
        ``keep_hits(leaf, packet, g, k, bits, found, prim_ids)`` takes those of a ray with some
        triangles of a block; likewise.
    surfaces : bool
        One hit per crossing of a surface, at edges and vertices too.
    wants_any, filter
        See `kernels.best.Best`; the filter is a `PacketFilter` or None.
    collector : Collector or None
        Takes all hits, or says that they are counted.
    """

    keep_lanes: Any
    keep_hits: Any
    surfaces: bool
    wants_any: bool
    filter: PacketFilter | None
    collector: Any


class TriangleLeaf(NamedTuple):
    """Leaves of triangles, see `walks.packet.trace_packet`.

    Attributes
    ----------
    visit, prefetch : device function
    lanes_best, ray_best : device function
        ``lanes_best(leaf, packet, g)`` is the `Best` of a group, and ``ray_best(leaf, packet, g,
        k)`` that of its ray k.
    within : Within or None
        None in a scene without instances.
    kind : Kind
    """

    visit: Any
    prefetch: Any
    lanes_best: Any
    ray_best: Any
    within: Within | None
    kind: Kind


@device
def box_planes(node, lane, rays):
    """Near x, y, z and far x, y, z planes of a child's box, for a `RayClass`."""
    x, y, z = rays.x, rays.y, rays.z
    planes = NodeLanes(node).planes
    near = planes[x.near, lane], planes[y.near, lane], planes[z.near, lane]
    return (*near, planes[x.far, lane], planes[y.far, lane], planes[z.far, lane])


@device
def _group_interval(group, planes):
    """Slab interval of a box for the 16 rays of a group."""
    planes = in_all_lanes(*planes[:3]) + in_all_lanes(*planes[3:])
    return slab_interval(planes, three(group.inv), three(group.near), three(group.far))


@device
def entering_rays(packet, g, box, rays):
    """Bits of the rays of a group that enter a box, see `box_planes`, within their intervals."""
    group = Group(packet, g)
    t_in, t_out = _group_interval(group, box)
    return mask_bits(maximum(t_in, rays.t_min) <= minimum(t_out, group.t_active))


@device
def entering_groups(packet, box, rays, groups):
    """Bits of those of some groups of which a ray enters a box, see `entering_rays`."""
    left = groups
    while left != ZERO_U64:
        g = count_trailing_zeros(left)
        left &= left - ONE_U64
        groups ^= np.uint64(entering_rays(packet, g, box, rays) == ZERO_U64) << g
    return groups


@device
def vertices(block, x, y, z):
    """The vertices of a block's four triangles, with the axes in this order."""
    corners = block.corners
    a = corners[_FIRST, x], corners[_FIRST, y], corners[_FIRST, z]
    b = corners[_SECOND, x], corners[_SECOND, y], corners[_SECOND, z]
    c = corners[_THIRD, x], corners[_THIRD, y], corners[_THIRD, z]
    return a, b, c


@device
def _own_planes(planes, at, rays):
    """Write near and far planes of the boxes of a block's triangles; returns their number."""
    near, far, prim_ids, count = planes.near, planes.far, BlockLanes(at).prim_ids, ONE_U64
    low, high = extents(*vertices(Block(at), _X, _Y, _Z))
    own = planes_along(low, high, (rays.x.back, rays.y.back, rays.z.back))
    near[_X], near[_Y], near[_Z], far[_X], far[_Y], far[_Z] = own
    while count != np.uint64(4) and prim_ids[count] >= np.int32(0):
        count += ONE_U64
    return count


@device
def _block_ray(lanes, k, rays):
    """The `BlockRay` of a ray of a group."""
    x, y, z = rays.kx, rays.ky, rays.kz
    inv, near, far = lanes.inv, lanes.near, lanes.far
    origin, direction, shear = lanes.origin, lanes.direction, lanes.shear
    return BlockRay(
        (x * AXIS, y * AXIS, z * AXIS),
        (inv[x, k], inv[y, k], inv[z, k]),
        (near[x, k], near[y, k], near[z, k]),
        (far[x, k], far[y, k], far[z, k]),
        (origin[x, k], origin[y, k], origin[z, k]),
        (direction[x, k], direction[y, k], direction[z, k]),
        (shear[_X, k], shear[_Y, k], shear[_Z, k]),
    )


@device
def _test_triangle(leaf, packet, g, at, lane, rays, own):
    """Test a triangle of a block against a group; returns whether a ray's search is shorter now."""
    kx, ky, kz = rays.kx, rays.ky, rays.kz
    group, block, planes = Group(packet, g), BlockLanes(at), _ScratchLanes(address_of(own))
    corners = block.corners
    a = corners[_FIRST, kx, lane], corners[_FIRST, ky, lane], corners[_FIRST, kz, lane]
    b = corners[_SECOND, kx, lane], corners[_SECOND, ky, lane], corners[_SECOND, kz, lane]
    c = corners[_THIRD, kx, lane], corners[_THIRD, ky, lane], corners[_THIRD, kz, lane]
    origin = group.origin[kx], group.origin[ky], group.origin[kz]
    direction, shear = group.direction, group.shear
    wide = in_all_lanes(*a), in_all_lanes(*b), in_all_lanes(*c)
    sheared = shear_vertices(*wide, origin, (shear[_X], shear[_Y]))
    # Signs of edge functions first: most triangles of a leaf are missed by all 16 rays.
    candidates = signs_agree(sheared)
    if not any_lane(candidates):
        return False
    # Hits count within the triangle's own padded box only, so that no structure decides them.
    near, far = planes.near, planes.far
    entered = near[_X, lane], near[_Y, lane], near[_Z, lane]
    box = (*entered, far[_X, lane], far[_Y, lane], far[_Z, lane])
    interval, limits = _group_interval(group, box), (group.t_min, group.t_active)
    along = direction[kx], direction[ky], direction[kz]
    plane, surfaces = ((a, b, c, origin, along), plane_distance), leaf.kind.surfaces
    then = (leaf, packet, g, block.prim_ids[lane]), _keep_lanes
    kept = intersect_lanes(sheared, candidates, interval, limits, plane, surfaces, then)
    return kept != ZERO_U64


@device
def _keep_lanes(taken, t, u, v, leaf, packet, g, prim_id):
    return np.uint64(leaf.kind.keep_lanes(leaf, packet, g, taken, t, u, v, prim_id))


@device
def _test_rays(leaf, packet, g, bits, block, rays, own):
    """Test a block against some rays of a group; returns whether a ray's search is shorter now."""
    lanes, found, has_hit = GroupLanes(packet, g), address_of(own.hits), False
    prim_ids = BlockLanes(block).prim_ids
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        ray = _block_ray(lanes, k, rays)
        hit = test_block(block, ray, lanes.t_min[k], lanes.t_active[k], leaf.kind.surfaces, found)
        if hit != ZERO_U64:
            has_hit |= leaf.kind.keep_hits(leaf, packet, g, k, hit, HitLanes(found), prim_ids)
    return has_hit


@device
def visit_leaf(leaf, packet, child, leaves, box, rays, groups, own):
    """Test a leaf's triangles against groups of a packet.

    Parameters
    ----------
    leaf : TriangleLeaf
    packet : uint64
    child : int32
        The leaf's link.
    leaves : uint64
    box : tuple of six float32
        Its planes, see `box_planes`.
    rays : RayClass
    groups : uint64
        Bits of those that enter the box.
    own : view of LEAF_SCRATCH

    Returns
    -------
    bool
        Whether a ray's search is shorter now.
    """
    at = leaf_address(leaves, child)
    end = leaf_end(at, child)
    has_hit = False
    while at != end:
        count = ZERO_U64
        left = groups
        while left != ZERO_U64:
            g = count_trailing_zeros(left)
            left &= left - ONE_U64
            bits = entering_rays(packet, g, box, rays)
            if bits == ZERO_U64:
                continue
            if popcount(bits) <= _FEW:
                has_hit |= _test_rays(leaf, packet, g, bits, at, rays, own)
            else:
                if count == ZERO_U64:  # the planes are for many rays: most blocks do without
                    count = _own_planes(own, at, rays)
                for lane in range(count):
                    has_hit |= _test_triangle(leaf, packet, g, at, lane, rays, own)
        at += BLOCK
    return has_hit
