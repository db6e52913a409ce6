"""The nearest triangles of a point in the wide tree.

The boxes of a node's eight children are tested at once, in float32, with bounds of the rounding: a
box is left out only if its distance exceeds the limit for sure. The children within are visited by
increasing distance. The triangles of a leaf block are tested at once, in float64, by the function
that defines the distance, so the answers have the bits of brute force.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x4,
    f32x8,
    f64x8,
    float_as_bits,
    fma,
    i32x8,
    lane_numbers,
    lanes_from_bits,
    load,
    mask8,
    mask_bits,
    maximum,
    minimum,
    narrow,
    next_float_up,
    scratch,
    store,
    widen,
)
from raystream.kernels.answers import loop_of
from raystream.kernels.leaf_block import AXIS, BLOCK, PRIM_IDS, SECOND, THIRD
from raystream.kernels.nearest import corners_at, is_wanted, offer_nearest
from raystream.kernels.point_queries import PointSearch, nearest_answer
from raystream.kernels.point_triangle import squared_distance
from raystream.structures.bvh.node_layout import BOX_FLIP, NODE_AXIS, Node
from raystream.structures.bvh.steps import leaf_blocks
from raystream.structures.bvh.walk import STACK_BYTES, tree_walk

_STRIDE = np.int32(16)  # `kernels.leaf_block.AXIS`
_CHILD_COUNT, _BLOCK_COUNT = np.uint64(8), np.uint64(4)
_KEY_BITS = np.int32(~7)
_ZERO = np.float32(0.0)
_ZERO64 = np.float64(0.0)

#: Below infinity, the distance of absent children.
_MOST = np.float32(np.finfo(np.float32).max)

#: Points further from the origin than this many times the scene's largest coordinate: in float32
#: the rounding of the point would be too much of the differences between boxes.
_FAR = np.float64(64.0)

#: Squared distances of boxes are reduced by these, a factor and, for numbers that vanish, a
#: difference: more than their own rounding, which is below 6 * 2**-24 of them, and that of the
#: triangles' distances, as far as it is in proportion to the distance: 2**-48. The difference is
#: a normal number: with a subnormal one a multiplication with addition takes a Skylake processor
#: some 150 cycles, which slowed the search by a factor of 1.4.
_SHRINK = np.float32(1.0 - 2.0**-20)
_LOSS = np.float32(-(2.0**-120))
_SHRINK64 = np.float64(1.0 - 2.0**-44)

#: The rounding of triangles' distances is also in proportion to the triangle's size: boxes are
#: grown by more than that, in units of the scene's largest coordinate.
_GROW = 2.0**-45

#: The rows of a node's planes.
_LOW_X, _HIGH_X, _LOW_Y, _HIGH_Y, _LOW_Z, _HIGH_Z = map(np.uint64, range(6))


@device
def _gap(low, high, below, above):
    """How far a point between `below` and `above` is at least from intervals, in float32."""
    return maximum(maximum(low - above, below - high), f32x8(_ZERO))


@device
def _far_gap(low, high, x):
    return maximum(maximum(widen(low) - x, x - widen(high)), f64x8(_ZERO64))


@device
def _keys(distances):
    """Sort keys of children, see `steps.enter`."""
    return (float_as_bits(distances) & _KEY_BITS) | lane_numbers(i32x8)


@device
def _enter_far(node, point, search):
    """Find the boxes within the limit of a point from afar; see `steps.enter` for the results."""
    planes = Node(node).planes
    x = _far_gap(planes[_LOW_X], planes[_HIGH_X], point[0])
    y = _far_gap(planes[_LOW_Y], planes[_HIGH_Y], point[1])
    z = _far_gap(planes[_LOW_Z], planes[_HIGH_Z], point[2])
    squared = (x * x + y * y + z * z) * _SHRINK64
    return _keys(minimum(narrow(squared), f32x8(_MOST))), squared <= search.limit


@device
def _lane_gap(node, axis, lane, x):
    at = node + axis * NODE_AXIS + (lane << SHIFT_32)
    low, high = np.float64(load(np.float32, at)), np.float64(load(np.float32, at + BOX_FLIP))
    return maximum(maximum(low - x, x - high), _ZERO64)


@device
def _enter_far_by_lane(node, point, search):
    """The same one child at a time, for threads with few registers."""
    lanes = scratch(64)
    bits = ZERO_U64
    for lane in range(_CHILD_COUNT):
        x = _lane_gap(node, ZERO_U64, lane, point[0])
        y = _lane_gap(node, ONE_U64, lane, point[1])
        z = _lane_gap(node, ONE_U64 + ONE_U64, lane, point[2])
        squared = (x * x + y * y + z * z) * _SHRINK64
        bits |= np.uint64(squared <= search.limit) << lane
        key = float_as_bits(minimum(np.float32(squared), _MOST)) & _KEY_BITS
        store(lanes + (lane << SHIFT_32), np.int32(key | np.int32(lane)))
    return load(i32x8, lanes), lanes_from_bits(mask8, bits)


@device
def _enter_near(node, near, limit):
    """Find the boxes within the limit; see `steps.enter` for the results."""
    planes = Node(node).planes
    below, above, _ = near
    x = _gap(planes[_LOW_X], planes[_HIGH_X], below[0], above[0])
    y = _gap(planes[_LOW_Y], planes[_HIGH_Y], below[1], above[1])
    z = _gap(planes[_LOW_Z], planes[_HIGH_Z], below[2], above[2])
    distances = maximum(fma(x * x + y * y + z * z, _SHRINK, _LOSS), f32x8(_ZERO))
    return _keys(distances), distances <= limit


@device
def _below(x):
    """A float32 below a float64."""
    return -next_float_up(np.float32(-x))


@device
def _above(x):
    """A float32 above a float64."""
    return next_float_up(np.float32(x))


@device
def _near(point, frame):
    """A point as the test of boxes takes it: numbers below and above, and whether it is far."""
    x, y, z = point
    reach = np.float64(frame.max_coordinate)
    is_far = max(max(abs(x), abs(y)), abs(z)) > _FAR * reach
    grow = _GROW * reach
    below = _below(x - grow), _below(y - grow), _below(z - grow)
    above = _above(x + grow), _above(y + grow), _above(z + grow)
    return below, above, is_far


@device
def _interval(line, search):
    """Distances of boxes up to the search's limit in float32, which is not below it."""
    far = min(_above(search.limit), _MOST)
    return _ZERO, far, far


@device
def _corner(at):
    x, y, z = load(f32x4, at), load(f32x4, at + AXIS), load(f32x4, at + (AXIS + AXIS))
    return widen(x), widen(y), widen(z)


@device
def _offer_block(block, point, search):
    """Offer the triangles of a leaf block."""
    lanes = scratch(64)
    a, b, c = _corner(block), _corner(block + SECOND), _corner(block + THIRD)
    squared = squared_distance(point, a, b, c)
    bits = mask_bits(squared <= search.limit)
    if bits != ZERO_U64:
        store(lanes, squared)
        while bits != ZERO_U64:
            lane = count_trailing_zeros(bits)
            bits &= bits - ONE_U64
            of_lane = load(np.float64, lanes + (lane << SHIFT_64))
            place = block + (lane << SHIFT_32)
            prim_id = load(np.int32, place + PRIM_IDS)
            if is_wanted(search, of_lane, prim_id):
                search = offer_nearest(search, of_lane, prim_id, place, _STRIDE)
    return search


@device
def _offer_block_by_lane(block, point, search):
    """The same one triangle at a time, for threads with few registers."""
    for lane in range(_BLOCK_COUNT):
        place = block + (lane << SHIFT_32)
        a, b, c = corners_at(place, _STRIDE)
        squared = squared_distance(point, a, b, c)
        prim_id = load(np.int32, place + PRIM_IDS)
        if is_wanted(search, squared, prim_id):
            search = offer_nearest(search, squared, prim_id, place, _STRIDE)
    return search


def _tree_search(enter_far, offer_block):
    """Make the search of the tree; see `kernels.point_queries.PointSearch`."""

    @device
    def enter(node, line, search, _, far):
        point, near = line
        if near[2]:
            return enter_far(node, point, search)
        return _enter_near(node, near, far)

    @device
    def visit_leaf(tree, child, line, search, stack):
        point, _ = line
        block, end = leaf_blocks(tree, child)
        while block != end:
            search = offer_block(block, point, search)
            block += BLOCK
        return search, False

    walk = tree_walk(_interval, enter, visit_leaf)

    @device
    def find(tree, frame, point, search, stack):
        return walk(tree, (point, _near(point, frame)), search, stack, False)

    return PointSearch(find, STACK_BYTES)


#: The search of a point by a thread of a GPU.
POINT_SEARCH = _tree_search(_enter_far_by_lane, _offer_block_by_lane)

#: The loop over points.
find_nearest = loop_of(*nearest_answer(_tree_search(_enter_far, _offer_block)))
