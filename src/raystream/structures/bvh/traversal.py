"""One ray through the wide tree: the form of traversal that answers every query."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    address,
    any_lane,
    count_bits,
    f32x4,
    f32x8,
    first_bit,
    float_as_bits,
    i32x4,
    i32x8,
    lane_bits,
    load,
    maximum,
    minimum,
    permute,
    scratch,
    select,
    store,
    widen,
)
from raystream.kernels.collect import keep_hit
from raystream.kernels.queries import AGAIN
from raystream.kernels.ray import pick
from raystream.kernels.seen import FULL, OLD, mark_seen
from raystream.kernels.tally import LEAVES, STEPS, TESTS, add_to
from raystream.kernels.triangle_lanes import (
    distance_lanes,
    image_lanes,
    interval_lanes,
    same_sign,
    weigh_lanes,
)
from raystream.structures.bvh.layout import STACK_SIZE
from raystream.structures.bvh.wide import (
    BLOCK,
    BOX_FLIP,
    CHILDREN,
    LANE,
    NODE,
    PRIM_IDS,
    SECOND,
    THIRD,
    leaf_address,
    leaf_end,
    plane_offset,
    sort_keys,
    t_key,
)

__all__ = ["STACK_BYTES", "LaneFrame", "TreeAddresses", "lane_frame", "test_block", "traverse"]

_ONE = np.uint64(1)
_NONE = np.uint64(0)
_ZERO = np.float32(0.0)
_KEY_BITS = np.int32(~7)
_NO_KEY = np.int32(-1)
_NO_TRIANGLE = np.int32(-1)
_U = np.uint64(16)
_V = np.uint64(32)

#: Entries of the stacks of keys and children, with room for the eight lanes always stored.
_HALF = np.uint64(4 * (STACK_SIZE + 15) // 64 * 64 + 64)

#: Bytes of the stack that `traverse` is given.
STACK_BYTES = 2 * int(_HALF)


class TreeAddresses(NamedTuple):
    """`layout.BvhArrays` as kernels take them; whoever calls one keeps the arrays alive.

    Attributes
    ----------
    nodes, leaves : uint64
        Addresses of the first node and the first leaf block; 0 for an empty tree.
    """

    nodes: np.uint64
    leaves: np.uint64


class LaneFrame(NamedTuple):
    """A ray's numbers in the order of its frame, and where a node or block has its axes."""

    plane: object
    axis: object
    inv: object
    near: object
    far: object
    origin: object
    direction: object
    shear: object


@device
def lane_frame(ray):
    """What `test_block` needs of a ray."""
    kx, ky, kz = ray.kx, ray.ky, ray.kz
    inv_x = pick(kx, ray.inv_x, ray.inv_y, ray.inv_z)
    inv_y = pick(ky, ray.inv_x, ray.inv_y, ray.inv_z)
    inv_z = ray.sz
    return LaneFrame(
        (plane_offset(kx, inv_x), plane_offset(ky, inv_y), plane_offset(kz, inv_z)),
        (kx << np.uint64(4), ky << np.uint64(4), kz << np.uint64(4)),
        (inv_x, inv_y, inv_z),
        (
            pick(kx, ray.near_x, ray.near_y, ray.near_z),
            pick(ky, ray.near_x, ray.near_y, ray.near_z),
            pick(kz, ray.near_x, ray.near_y, ray.near_z),
        ),
        (
            pick(kx, ray.far_x, ray.far_y, ray.far_z),
            pick(ky, ray.far_x, ray.far_y, ray.far_z),
            pick(kz, ray.far_x, ray.far_y, ray.far_z),
        ),
        (ray.ox, ray.oy, ray.oz),
        (ray.dx, ray.dy, ray.dz),
        (ray.sx, ray.sy, ray.sz),
    )


@device
def _corner(at, axis):
    return load(f32x4, at + axis[0]), load(f32x4, at + axis[1]), load(f32x4, at + axis[2])


@device
def test_block(block, frame, t_min, t_far, surfaces, lanes):
    """Test the four triangles of a leaf block against a ray.

    Parameters
    ----------
    block : uint64
        Address.
    frame : LaneFrame
    t_min, t_far : float32
        Closed interval in which a hit is wanted.
    surfaces : bool
        The rule at edges and vertices, see `kernels.triangle.intersect`.
    lanes : uint64
        Address of 48 bytes: t, u and v of the lanes that are hit are written.

    Returns
    -------
    uint64
        Bits of the lanes that are hit.
    """
    a = _corner(block, frame.axis)
    b = _corner(block + SECOND, frame.axis)
    c = _corner(block + THIRD, frame.axis)
    o, s = frame.origin, frame.shear
    images = image_lanes(*a, *b, *c, *o, s[0], s[1])
    candidates = same_sign(images)
    if not any_lane(candidates):
        return _NONE
    low_x, high_x = minimum(minimum(a[0], b[0]), c[0]), maximum(maximum(a[0], b[0]), c[0])
    low_y, high_y = minimum(minimum(a[1], b[1]), c[1]), maximum(maximum(a[1], b[1]), c[1])
    low_z, high_z = minimum(minimum(a[2], b[2]), c[2]), maximum(maximum(a[2], b[2]), c[2])
    back_x, back_y, back_z = frame.inv[0] < _ZERO, frame.inv[1] < _ZERO, frame.inv[2] < _ZERO
    t_in, t_out = interval_lanes(
        select(back_x, high_x, low_x),
        select(back_y, high_y, low_y),
        select(back_z, high_z, low_z),
        select(back_x, low_x, high_x),
        select(back_y, low_y, high_y),
        select(back_z, low_z, high_z),
        frame.inv,
        frame.near,
        frame.far,
    )
    candidates = candidates & (t_in <= t_out) & (t_in <= t_far) & (t_out >= t_min)
    if not any_lane(candidates):
        return _NONE
    hit, u, v = weigh_lanes(images, surfaces)
    d = frame.direction
    t = distance_lanes(
        (widen(a[0]), widen(a[1]), widen(a[2])),
        (widen(b[0]), widen(b[1]), widen(b[2])),
        (widen(c[0]), widen(c[1]), widen(c[2])),
        (np.float64(o[0]), np.float64(o[1]), np.float64(o[2])),
        (np.float64(d[0]), np.float64(d[1]), np.float64(d[2])),
    )
    t = minimum(maximum(t, t_in), t_out) + _ZERO
    store(lanes, t)
    store(lanes + _U, u)
    store(lanes + _V, v)
    return lane_bits(candidates & hit & (t >= t_min) & (t <= t_far))


@device
def _triangles_in(block):
    """How many lanes of a leaf block hold a triangle."""
    return count_bits(lane_bits(load(i32x4, block + PRIM_IDS) > i32x4(_NO_TRIANGLE)))


@device
def traverse(tree, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen, tally):
    """Visit the boxes that a ray meets; see `kernels.queries.ray_queries` for the arguments.

    The stack holds children with a key each: where the ray enters their box, with the lane in
    the lowest three bits, so that eight keys are sorted at once.
    """
    count = _NONE
    if tree.nodes == _NONE or not (t_min <= t_max):
        return count
    t_far = t_max
    frame = lane_frame(ray)
    lanes = scratch(64)
    numbers = scratch(32)
    for k in range(np.uint64(8)):
        store(numbers + k * LANE, np.int32(k))
    lane_numbers = load(i32x8, numbers)
    table, room = address(seen), np.uint64(len(seen)) - _ONE
    keys, children = stack, stack + _HALF
    store(keys, np.int32(0))
    store(children, np.int32(0))
    top = LANE
    while top != _NONE:
        top -= LANE
        if load(np.int32, keys + top) > t_key(t_far):
            continue
        child = load(np.int32, children + top)

        if child < np.int32(0):
            block = leaf_address(tree.leaves, child)
            end = leaf_end(block, child)
            add_to(tally, LEAVES, _ONE)
            while block != end:
                bits = test_block(block, frame, t_min, t_far, surfaces, lanes)
                add_to(tally, TESTS, _triangles_in(block))
                while bits != _NONE:
                    at = first_bit(bits) << np.uint64(2)
                    bits &= bits - _ONE
                    prim_id = load(np.int32, block + PRIM_IDS + at)
                    if room != _NONE:
                        answer = mark_seen(table, room, prim_id)
                        if answer == OLD:
                            continue
                        if answer == FULL:
                            return AGAIN
                    if keep:
                        count, t_far = keep_hit(
                            out,
                            first,
                            count,
                            capacity,
                            load(np.float32, lanes + at),
                            load(np.float32, lanes + (_U + at)),
                            load(np.float32, lanes + (_V + at)),
                            prim_id,
                            t_far,
                        )
                    else:
                        count += _ONE
                        if count == capacity:
                            return count
                block += BLOCK
            continue

        add_to(tally, STEPS, _ONE)
        node = tree.nodes + np.uint64(child) * NODE
        at_x, at_y, at_z = node + frame.plane[0], node + frame.plane[1], node + frame.plane[2]
        t_in, t_out = interval_lanes(
            load(f32x8, at_x),
            load(f32x8, at_y),
            load(f32x8, at_z),
            load(f32x8, at_x ^ BOX_FLIP),
            load(f32x8, at_y ^ BOX_FLIP),
            load(f32x8, at_z ^ BOX_FLIP),
            frame.inv,
            frame.near,
            frame.far,
        )
        entered = maximum(t_in, t_min) <= minimum(t_out, t_far)
        # Only the order of the bits of positive numbers is that of the numbers.
        key = (float_as_bits(maximum(t_in, _ZERO)) & _KEY_BITS) | lane_numbers
        key = sort_keys(select(entered, key, i32x8(_NO_KEY)))
        store(keys + top, key)
        store(children + top, permute(load(i32x8, node + CHILDREN), key))
        top += count_bits(lane_bits(entered)) << np.uint64(2)
    return count
