"""Testing the rays of a stream's list against a block of four triangles."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    count_trailing_zeros,
    load,
    mask_bits,
    maximum,
    minimum,
    select,
    store,
    widen,
)
from raystream.jit.views import address_of
from raystream.kernels.leaf_block import HitLanes
from raystream.kernels.triangle_lanes import (
    distance_lanes,
    image_lanes,
    interval_lanes,
    same_sign,
    weigh_lanes,
)
from raystream.structures.bvh.stream_rays import Cold, Hot
from raystream.structures.bvh.wide import LANE

__all__ = ["test_block"]

_U0, _U1 = np.uint64(0), np.uint64(1)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_FIRST, _SECOND, _THIRD = np.uint64(0), np.uint64(1), np.uint64(2)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)


@device
def _axes(hot):
    """The axes of a ray's frame."""
    kx, ky, kz = hot.axes
    return np.uint64(kx), np.uint64(ky), np.uint64(kz)


@device
def _images(hot, cold, block):
    """The corners of a block's four triangles in a ray's frame."""
    x, y, z = _axes(hot)
    ox, oy, oz = hot.origin
    corners = block.corners
    return image_lanes(
        corners[_FIRST, x],
        corners[_FIRST, y],
        corners[_FIRST, z],
        corners[_SECOND, x],
        corners[_SECOND, y],
        corners[_SECOND, z],
        corners[_THIRD, x],
        corners[_THIRD, y],
        corners[_THIRD, z],
        ox,
        oy,
        oz,
        hot.sx,
        cold.sy,
    )


@device
def _corner64(corners, corner, x, y, z):
    return widen(corners[corner, x]), widen(corners[corner, y]), widen(corners[corner, z])


@device
def _point64(x, y, z):
    return np.float64(x), np.float64(y), np.float64(z)


@device
def _distances(hot, cold, block):
    x, y, z = _axes(hot)
    corners = block.corners
    return distance_lanes(
        _corner64(corners, _FIRST, x, y, z),
        _corner64(corners, _SECOND, x, y, z),
        _corner64(corners, _THIRD, x, y, z),
        _point64(*hot.origin),
        _point64(*cold.direction),
    )


@device
def test_block(rays, count, stream, block, backward, hits, lanes, wants_any):
    """Test the rays of a list against a block of triangles; returns how many have a hit."""
    # Step 1: the rays whose edge functions agree in sign, written without a branch. (With one
    # for each ray, those that the processor foresees wrongly cost half the time of a leaf.)
    candidate_count = _U0
    for j in range(count):
        number = load(np.uint32, rays + j * LANE)
        hot, cold = Hot(stream.hot, np.uint64(number)), Cold(stream.cold, np.uint64(number))
        store(hits + candidate_count * LANE, number)
        candidate_count += np.uint64(any_lane(same_sign(_images(hot, cold, block))))
    if candidate_count == _U0:
        return _U0

    # Step 2: exactly.
    hit_count = _U0
    back_x, back_y, back_z = backward
    low_x, high_x = _extent(block, _X)
    low_y, high_y = _extent(block, _Y)
    low_z, high_z = _extent(block, _Z)
    near_x, far_x = select(back_x, high_x, low_x), select(back_x, low_x, high_x)
    near_y, far_y = select(back_y, high_y, low_y), select(back_y, low_y, high_y)
    near_z, far_z = select(back_z, high_z, low_z), select(back_z, low_z, high_z)
    for j in range(candidate_count):
        number = np.uint64(load(np.uint32, hits + j * LANE))
        hot, cold = Hot(stream.hot, number), Cold(stream.cold, number)
        t_in, t_out = interval_lanes(
            near_x,
            near_y,
            near_z,
            far_x,
            far_y,
            far_z,
            hot.inv,
            hot.near,
            hot.far,
        )
        nearest, t_min = hot.t, hot.t_min
        images = _images(hot, cold, block)
        candidates = same_sign(images) & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
        if any_lane(candidates):
            # The distance first: rays that leave a surface meet its triangle behind their
            # origin, and need no weights.
            t = minimum(maximum(_distances(hot, cold, block), t_in), t_out) + _ZERO
            candidates = candidates & (t >= t_min) & (t <= nearest)
            if not any_lane(candidates):
                continue
            hit, u, v = weigh_lanes(images, False)
            bits = mask_bits(candidates & hit)
            if bits != _U0:
                hit_count += _U1
                if wants_any:
                    cold.prim_id, hot.t = np.int32(0), -_INF
                else:
                    lanes.t, lanes.u, lanes.v = t, u, v
                    _keep_nearest(hot, cold, block, bits, HitLanes(address_of(lanes)))
    return hit_count


@device
def _extent(block, axis):
    """Low and high coordinates of four triangles along an axis."""
    corners = block.corners
    a, b, c = corners[_FIRST, axis], corners[_SECOND, axis], corners[_THIRD, axis]
    return minimum(minimum(a, b), c), maximum(maximum(a, b), c)


@device
def _keep_nearest(hot, cold, block, bits, lanes):
    """Take the hits of these lanes, if they are before the ray's by t, then prim_id."""
    nearest, best = hot.t, cold.prim_id
    while bits != _U0:
        lane = count_trailing_zeros(bits)
        bits &= bits - _U1
        t, prim_id = lanes.t[lane], block.prim_ids[lane]
        if t < nearest or (t == nearest and prim_id < best):
            nearest, best = t, prim_id
            cold.u, cold.v = lanes.u[lane], lanes.v[lane]
    hot.t, cold.prim_id = nearest, best
