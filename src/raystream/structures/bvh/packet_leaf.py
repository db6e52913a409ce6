"""Testing groups of a packet against boxes and triangles, 16 rays at a time."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    f32x4,
    f32x16,
    fma,
    i32x16,
    load,
    maximum,
    minimum,
    select,
    store,
    widen,
)
from raystream.kernels.leaf_block import AXIS, BLOCK, PRIM_IDS, SECOND, THIRD
from raystream.kernels.triangle_lanes import distance_lanes, image_lanes, same_sign, weigh_lanes
from raystream.structures.bvh.packet_hits import collect
from raystream.structures.bvh.packet_rays import (
    ARRAY,
    DIRECTION,
    FAR,
    GROUP,
    INV,
    LIVE_T,
    NEAR,
    ORIGIN,
    PRIM,
    SHEAR,
    T_MIN,
    U,
    V,
)
from raystream.structures.bvh.wide import LANE, leaf_address, leaf_end

__all__ = ["ALL", "ANY", "COUNT", "FIRST", "SURFACES", "group_range", "visit_leaf"]

#: What is wanted of each ray: its nearest hit; whether there is one; how many there are (in
#: the place of its nearest triangle); or all of them.
FIRST, ANY, COUNT, ALL = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
#: Added to `COUNT` and `ALL`: at edges and vertices, the crossings of surfaces.
SURFACES = np.uint64(4)

_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_U0 = np.uint64(0)
_U1 = np.uint64(1)
_U2 = np.uint64(2)
_DOWN = np.uint64(2**64 - int(GROUP))

# The planes of a block's four triangles' own boxes: near x, y, z, then far.
_PLANE = np.uint64(16)
_FAR_PLANES = np.uint64(48)


@device
def _group_interval(rays, near_x, near_y, near_z, far_x, far_y, far_z):
    """Slab interval of a box, or of a triangle's own, for the 16 rays of a group."""
    inv_x = load(f32x16, rays + INV)
    inv_y = load(f32x16, rays + INV + ARRAY)
    inv_z = load(f32x16, rays + INV + ARRAY + ARRAY)
    t_in = maximum(
        maximum(
            fma(inv_x, near_x, load(f32x16, rays + NEAR)),
            fma(inv_y, near_y, load(f32x16, rays + NEAR + ARRAY)),
        ),
        fma(inv_z, near_z, load(f32x16, rays + NEAR + ARRAY + ARRAY)),
    )
    t_out = minimum(
        minimum(
            fma(inv_x, far_x, load(f32x16, rays + FAR)),
            fma(inv_y, far_y, load(f32x16, rays + FAR + ARRAY)),
        ),
        fma(inv_z, far_z, load(f32x16, rays + FAR + ARRAY + ARRAY)),
    )
    return t_in, t_out


@device
def group_range(packet, box, x, y, z, t_min, first, last):
    """The first and the last group from `first` to `last` of which a ray enters a box.

    Returns first > last if there is none.
    """
    near_x = load(np.float32, box + x.near_at)
    near_y = load(np.float32, box + y.near_at)
    near_z = load(np.float32, box + z.near_at)
    far_x = load(np.float32, box + x.far_at)
    far_y = load(np.float32, box + y.far_at)
    far_z = load(np.float32, box + z.far_at)
    step = GROUP
    rays = packet + first * GROUP
    end = packet + last * GROUP
    # Up to the first one, then down to the last one.
    while True:
        t_in, t_out = _group_interval(rays, near_x, near_y, near_z, far_x, far_y, far_z)
        if any_lane(maximum(t_in, t_min) <= minimum(t_out, load(f32x16, rays + LIVE_T))):
            if step == GROUP:
                first = (rays - packet) // GROUP
                step = _DOWN
                rays, end = end, rays
                if rays != end:
                    continue
            return first, (rays - packet) // GROUP
        if rays == end:
            # Going down, the first one is known to enter.
            return (_U1, _U0) if step == GROUP else (first, first)
        rays += step


@device
def _own_planes(planes, block, x, y, z):
    """Near and far planes of four triangles' own boxes."""
    for axis in range(np.uint64(3)):
        at = block + axis * AXIS
        a, b, c = load(f32x4, at), load(f32x4, at + SECOND), load(f32x4, at + THIRD)
        low = minimum(minimum(a, b), c)
        high = maximum(maximum(a, b), c)
        back = x.back if axis == _U0 else (y.back if axis == _U1 else z.back)
        store(planes + axis * _PLANE, select(back, high, low))
        store(planes + axis * _PLANE + _FAR_PLANES, select(back, low, high))


@device
def _corner(at, at_x, at_y, at_z):
    """A corner in float64, in the order of the frame."""
    return (
        np.float64(load(np.float32, at + at_x)),
        np.float64(load(np.float32, at + at_y)),
        np.float64(load(np.float32, at + at_z)),
    )


@device
def _three(numbers, at_x, at_y, at_z):
    """Points or directions of a group in float64, in the order of the frame."""
    return (
        widen(load(f32x16, numbers + (at_x << _U2))),
        widen(load(f32x16, numbers + (at_y << _U2))),
        widen(load(f32x16, numbers + (at_z << _U2))),
    )


@device
def _test_triangle(rays, group, triangle, planes, at_x, at_y, at_z, goal, hits):
    """Test one triangle against a group; returns whether any ray has a nearer hit.

    `triangle` and `planes` are addresses of its lane in its block and in its own planes.
    """
    second, third = triangle + SECOND, triangle + THIRD
    images = image_lanes(
        f32x16(load(np.float32, triangle + at_x)),
        f32x16(load(np.float32, triangle + at_y)),
        f32x16(load(np.float32, triangle + at_z)),
        f32x16(load(np.float32, second + at_x)),
        f32x16(load(np.float32, second + at_y)),
        f32x16(load(np.float32, second + at_z)),
        f32x16(load(np.float32, third + at_x)),
        f32x16(load(np.float32, third + at_y)),
        f32x16(load(np.float32, third + at_z)),
        load(f32x16, rays + ORIGIN + (at_x << _U2)),
        load(f32x16, rays + ORIGIN + (at_y << _U2)),
        load(f32x16, rays + ORIGIN + (at_z << _U2)),
        load(f32x16, rays + SHEAR),
        load(f32x16, rays + SHEAR + ARRAY),
    )
    candidates = same_sign(images)
    if not any_lane(candidates):
        return False
    t_in, t_out = _group_interval(
        rays,
        load(np.float32, planes),
        load(np.float32, planes + _PLANE),
        load(np.float32, planes + _PLANE + _PLANE),
        load(np.float32, planes + _FAR_PLANES),
        load(np.float32, planes + _FAR_PLANES + _PLANE),
        load(np.float32, planes + _FAR_PLANES + _PLANE + _PLANE),
    )
    nearest = load(f32x16, rays + LIVE_T)
    t_min = load(f32x16, rays + T_MIN)
    candidates = candidates & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
    if not any_lane(candidates):
        return False
    # The distance first: rays that leave a surface meet its triangle behind their origin, and
    # need no weights.
    t = distance_lanes(
        _corner(triangle, at_x, at_y, at_z),
        _corner(second, at_x, at_y, at_z),
        _corner(third, at_x, at_y, at_z),
        _three(rays + ORIGIN, at_x, at_y, at_z),
        _three(rays + DIRECTION, at_x, at_y, at_z),
    )
    t = minimum(maximum(t, t_in), t_out) + _ZERO
    candidates = candidates & (t >= t_min) & (t <= nearest)
    if not any_lane(candidates):
        return False
    hit, u, v = weigh_lanes(images, goal >= SURFACES)
    prim_id = i32x16(load(np.int32, triangle + PRIM_IDS))
    best = load(i32x16, rays + PRIM)
    taken = candidates & hit
    if goal > ANY:
        if goal & _U1 == _U1:
            collect(hits, taken, t, u, v, prim_id, rays, group)
        else:
            store(rays + PRIM, select(taken, best + np.int32(1), best))
        return False
    taken = taken & ((t < nearest) | (prim_id < best))
    if not any_lane(taken):
        return False
    store(rays + PRIM, select(taken, prim_id, best))
    if goal == ANY:
        store(rays + LIVE_T, select(taken, f32x16(-_INF), nearest))
        return True
    store(rays + LIVE_T, select(taken, t, nearest))
    store(rays + U, select(taken, u, load(f32x16, rays + U)))
    store(rays + V, select(taken, v, load(f32x16, rays + V)))
    return True


@device
def visit_leaf(packet, child, leaves, box, x, y, z, t_min, first, last, axes, planes, goal, hits):
    """Test a leaf's triangles against the groups `first` to `last`; whether there was a hit."""
    block = leaf_address(leaves, child)
    end = leaf_end(block, child)
    at_x, at_y, at_z = axes
    near_x = load(np.float32, box + x.near_at)
    near_y = load(np.float32, box + y.near_at)
    near_z = load(np.float32, box + z.near_at)
    far_x = load(np.float32, box + x.far_at)
    far_y = load(np.float32, box + y.far_at)
    far_z = load(np.float32, box + z.far_at)
    has_hit = False
    while block != end:
        _own_planes(planes, block, x, y, z)
        count = _U1
        while count != np.uint64(4):
            if load(np.int32, block + PRIM_IDS + count * LANE) < np.int32(0):
                break
            count += _U1
        for g in range(first, last + _U1):
            rays = packet + g * GROUP
            t_in, t_out = _group_interval(rays, near_x, near_y, near_z, far_x, far_y, far_z)
            if any_lane(maximum(t_in, t_min) <= minimum(t_out, load(f32x16, rays + LIVE_T))):
                for k in range(count):
                    at = k * LANE
                    if _test_triangle(
                        rays, g, block + at, planes + at, at_x, at_y, at_z, goal, hits
                    ):
                        has_hit = True
        block += BLOCK
    return has_hit
