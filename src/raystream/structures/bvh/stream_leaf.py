"""Testing the rays of a stream's list against a block of four triangles."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    f32x4,
    first_bit,
    lane_bits,
    load,
    maximum,
    minimum,
    select,
    store,
    widen,
)
from raystream.kernels.leaf_block import AXIS, PRIM_IDS, SECOND, THIRD
from raystream.kernels.triangle_lanes import (
    distance_lanes,
    image_lanes,
    interval_lanes,
    same_sign,
    weigh_lanes,
)
from raystream.structures.bvh.stream_rays import (
    COLD,
    COLD_DIRECTION,
    COLD_PRIM,
    COLD_SY,
    COLD_U,
    COLD_V,
    HOT,
    HOT_AXES,
    HOT_FAR,
    HOT_INV,
    HOT_NEAR,
    HOT_ORIGIN,
    HOT_SX,
    HOT_T,
    HOT_T_MIN,
    axis_offsets,
    three,
)
from raystream.structures.bvh.wide import LANE

__all__ = ["test_block"]

_U0 = np.uint64(0)
_U1 = np.uint64(1)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)


@device
def _images(hot, cold, block):
    """The corners of a block's four triangles in a ray's frame."""
    at_x, at_y, at_z = axis_offsets(load(np.uint32, hot + HOT_AXES))
    ox, oy, oz = three(hot + HOT_ORIGIN)
    second, third = block + SECOND, block + THIRD
    return image_lanes(
        load(f32x4, block + at_x),
        load(f32x4, block + at_y),
        load(f32x4, block + at_z),
        load(f32x4, second + at_x),
        load(f32x4, second + at_y),
        load(f32x4, second + at_z),
        load(f32x4, third + at_x),
        load(f32x4, third + at_y),
        load(f32x4, third + at_z),
        ox,
        oy,
        oz,
        load(np.float32, hot + HOT_SX),
        load(np.float32, cold + COLD_SY),
    )


@device
def _corner64(at, at_x, at_y, at_z):
    return (
        widen(load(f32x4, at + at_x)),
        widen(load(f32x4, at + at_y)),
        widen(load(f32x4, at + at_z)),
    )


@device
def _three64(record):
    x, y, z = three(record)
    return np.float64(x), np.float64(y), np.float64(z)


@device
def _distances(hot, cold, block):
    at_x, at_y, at_z = axis_offsets(load(np.uint32, hot + HOT_AXES))
    return distance_lanes(
        _corner64(block, at_x, at_y, at_z),
        _corner64(block + SECOND, at_x, at_y, at_z),
        _corner64(block + THIRD, at_x, at_y, at_z),
        _three64(hot + HOT_ORIGIN),
        _three64(cold + COLD_DIRECTION),
    )


@device
def test_block(rays, count, hot, cold, block, back_x, back_y, back_z, hits, lanes, wants_any):
    """Test the rays of a list against a block of triangles; returns how many have a hit."""
    # Step 1: the rays whose edge functions agree in sign, written without a branch. (With one
    # for each ray, those that the processor foresees wrongly cost half the time of a leaf.)
    candidate_count = _U0
    for j in range(count):
        number = load(np.uint32, rays + j * LANE)
        ray, more = hot + np.uint64(number) * HOT, cold + np.uint64(number) * COLD
        store(hits + candidate_count * LANE, number)
        candidate_count += np.uint64(any_lane(same_sign(_images(ray, more, block))))
    if candidate_count == _U0:
        return _U0

    # Step 2: exactly.
    hit_count = _U0
    low_x, high_x = _extent(block)
    low_y, high_y = _extent(block + AXIS)
    low_z, high_z = _extent(block + AXIS + AXIS)
    near_x, far_x = select(back_x, high_x, low_x), select(back_x, low_x, high_x)
    near_y, far_y = select(back_y, high_y, low_y), select(back_y, low_y, high_y)
    near_z, far_z = select(back_z, high_z, low_z), select(back_z, low_z, high_z)
    for j in range(candidate_count):
        number = np.uint64(load(np.uint32, hits + j * LANE))
        ray, more = hot + number * HOT, cold + number * COLD
        t_in, t_out = interval_lanes(
            near_x,
            near_y,
            near_z,
            far_x,
            far_y,
            far_z,
            three(ray + HOT_INV),
            three(ray + HOT_NEAR),
            three(ray + HOT_FAR),
        )
        nearest = load(np.float32, ray + HOT_T)
        t_min = load(np.float32, ray + HOT_T_MIN)
        images = _images(ray, more, block)
        candidates = same_sign(images) & (t_in <= t_out) & (t_in <= nearest) & (t_out >= t_min)
        if any_lane(candidates):
            # The distance first: rays that leave a surface meet its triangle behind their
            # origin, and need no weights.
            t = minimum(maximum(_distances(ray, more, block), t_in), t_out) + _ZERO
            candidates = candidates & (t >= t_min) & (t <= nearest)
            if not any_lane(candidates):
                continue
            hit, u, v = weigh_lanes(images, False)
            bits = lane_bits(candidates & hit)
            if bits != _U0:
                hit_count += _U1
                if wants_any:
                    store(more + COLD_PRIM, np.int32(0))
                    store(ray + HOT_T, -_INF)
                else:
                    store(lanes, t)
                    store(lanes + np.uint64(16), u)
                    store(lanes + np.uint64(32), v)
                    _keep_nearest(ray, more, block, bits, lanes)
    return hit_count


@device
def _extent(block):
    """Low and high coordinates of four triangles along an axis."""
    a, b, c = load(f32x4, block), load(f32x4, block + SECOND), load(f32x4, block + THIRD)
    return minimum(minimum(a, b), c), maximum(maximum(a, b), c)


@device
def _keep_nearest(hot, cold, block, bits, lanes):
    """Take the hits of these lanes, if they are before the ray's by t, then prim_id."""
    nearest = load(np.float32, hot + HOT_T)
    best = load(np.int32, cold + COLD_PRIM)
    while bits != _U0:
        at = first_bit(bits) * LANE
        bits &= bits - _U1
        t = load(np.float32, lanes + at)
        prim_id = load(np.int32, block + PRIM_IDS + at)
        if t < nearest or (t == nearest and prim_id < best):
            nearest = t
            best = prim_id
            store(cold + COLD_U, load(np.float32, lanes + np.uint64(16) + at))
            store(cold + COLD_V, load(np.float32, lanes + np.uint64(32) + at))
    store(hot + HOT_T, nearest)
    store(cold + COLD_PRIM, best)
