"""The nearest triangles of a point in the wide tree.

The boxes of a node's eight children are tested at once, in float32, with bounds of the rounding: a
box is left out only if its distance exceeds the limit for sure. The children within are visited by
increasing distance. The triangles of a leaf block are tested at once, in float64, by the function
that defines the distance, so the answers have the bits of brute force.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import (
    ONE_F64,
    ONE_U64,
    SHIFT_32,
    SHIFT_64,
    ZERO_F32,
    ZERO_F64,
    ZERO_U64,
)
from raystream.jit.cpu import device
from raystream.jit.simd import (
    count_trailing_zeros,
    f32x4,
    float_as_bits,
    fma,
    i32x8,
    lane_numbers,
    load,
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
from raystream.kernels.nearest import offer_squared
from raystream.kernels.point_queries import PointSearch, nearest_answer
from raystream.kernels.point_triangle import triangle_features
from raystream.structures.bvh.node_layout import Node
from raystream.structures.bvh.steps import leaf_blocks
from raystream.structures.bvh.walks.single import STACK_BYTES, tree_walk

STRIDE = np.int32(16)  # `kernels.leaf_block.AXIS`
_KEY_BITS, _FIRST = np.int32(~7), np.int32(0)

#: Below infinity, the distance of absent children.
_MOST, _MOST64 = np.float32(np.finfo(np.float32).max), np.float64(np.finfo(np.float64).max)

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
def _gap(low, high, below, above, zero):
    """How far a point between `below` and `above` is at least from an interval."""
    return maximum(maximum(low - above, below - high), zero)


@device
def near_distance(box, line):
    """A bound of the squared distances of boxes.

    Parameters
    ----------
    box : tuple of six float32 vectors or numbers
        Low x, high x, low y, high y, low z, high z.
    line : PointLine
        Not far.

    Returns
    -------
    float32 vector or number
    """
    low_x, high_x, low_y, high_y, low_z, high_z = box
    below, above = line.below, line.above
    x = _gap(low_x, high_x, below[0], above[0], ZERO_F32)
    y = _gap(low_y, high_y, below[1], above[1], ZERO_F32)
    z = _gap(low_z, high_z, below[2], above[2], ZERO_F32)
    return maximum(fma(x * x + y * y + z * z, _SHRINK, _LOSS), ZERO_F32)


@device
def far_distance(box, line):
    """The same in float64, for points from afar."""
    low_x, high_x, low_y, high_y, low_z, high_z = box
    (x, y, z), slack = line.point, line.slack
    x = _gap(widen(low_x), widen(high_x), x - slack, x + slack, ZERO_F64)
    y = _gap(widen(low_y), widen(high_y), y - slack, y + slack, ZERO_F64)
    z = _gap(widen(low_z), widen(high_z), z - slack, z + slack, ZERO_F64)
    return (x * x + y * y + z * z) * _SHRINK64


@device
def box_distances(box, line, search, far):
    """Bounds of the squared distances of boxes, and which are within the limit."""
    if line.is_far:
        squared = far_distance(box, line)
        limit = min(search.limit * line.unit, _MOST64)
        return minimum(narrow(squared), _MOST), squared <= limit
    distances = near_distance(box, line)
    return distances, distances <= far


@device
def _enter(node, line, search, _, far):
    """Find the boxes within the limit; see `steps.enter` for the results."""
    planes = Node(node).planes
    box = planes[_LOW_X], planes[_HIGH_X], planes[_LOW_Y], planes[_HIGH_Y]
    box = *box, planes[_LOW_Z], planes[_HIGH_Z]
    distances, entered = box_distances(box, line, search, far)
    return (float_as_bits(distances) & _KEY_BITS) | lane_numbers(i32x8), entered


@device
def _below(x):
    """A float32 below a float64."""
    return -next_float_up(np.float32(-x))


@device
def _above(x):
    """A float32 above a float64."""
    return next_float_up(np.float32(x))


class PointLine(NamedTuple):
    """A point as the tests of boxes take it.

    Attributes
    ----------
    point : triple of float64
        In the frame of the boxes.
    moved : triple of float64
        In that of the shapes; see `kernels.point_queries.PointSearch`.
    slack : float64
        By how much `point` may be wrong.
    unit : float64
        Squared distances of boxes are at most this times those of the shapes in them.
    below, above : triple of float32
        Numbers around its coordinates, by more than the rounding of triangles' distances.
    is_far : bool
        Whether float32 does not do; see `far_distance`.
    """

    point: tuple[float, float, float]
    moved: tuple[float, float, float]
    slack: float
    unit: float
    below: tuple[np.float32, np.float32, np.float32]
    above: tuple[np.float32, np.float32, np.float32]
    is_far: bool


@device
def line_of(query, frame):
    """A `PointQuery` as the tests of boxes take it."""
    return placed_line(query.local, query.moved, frame, query.slack, ONE_F64)


@device
def placed_line(point, moved, frame, slack, unit):
    """A point in a frame of boxes, and what else a `PointLine` has of it."""
    x, y, z = point
    reach = np.float64(frame.max_coordinate)
    is_far = max(max(abs(x), abs(y)), abs(z)) > _FAR * reach
    grow = _GROW * reach + slack
    below = _below(x - grow), _below(y - grow), _below(z - grow)
    above = _above(x + grow), _above(y + grow), _above(z + grow)
    return PointLine(point, moved, slack, unit, below, above, is_far)


@device
def interval(line, search):
    """Distances of boxes up to the search's limit in float32, which is not below it."""
    far = min(_above(search.limit * line.unit), _MOST)
    return ZERO_F32, far, far


@device
def _corner(at):
    x, y, z = load(f32x4, at), load(f32x4, at + AXIS), load(f32x4, at + (AXIS + AXIS))
    return widen(x), widen(y), widen(z)


@device
def offer_lanes(squared, block, search, rows, first=_FIRST):
    """Offer four shapes of a block by their squared distances.

    Parameters
    ----------
    squared : f64x4
    block : uint64
    search : NearestSearch
    rows : tuple of uint64 or None, uint64, int32, uint64
        Their place, or the power of two between their places, from `block`; where in the block
        their numbers are; and the stride, see `kernels.nearest.ROW`.
    first : int32
        Added to their numbers.

    Returns
    -------
    NearestSearch
    """
    place, shift, stride, ids = rows
    lanes = scratch(64)
    bits = mask_bits(squared <= search.limit)
    if bits != ZERO_U64:
        store(lanes, squared)
        while bits != ZERO_U64:
            lane = count_trailing_zeros(bits)
            bits &= bits - ONE_U64
            of_lane = load(np.float64, lanes + (lane << SHIFT_64))
            prim_id = np.int32(load(np.int32, block + ids + (lane << SHIFT_32)) + first)
            at = block + (lane << shift) if place is None else place
            search = offer_squared(search, of_lane, prim_id, at, stride)
    return search


@device
def block_squared(block, point):
    """Squared distances of the triangles of a leaf block."""
    a, b, c = _corner(block), _corner(block + SECOND), _corner(block + THIRD)
    return triangle_features(point, a, b, c).squared


@device
def _visit_leaf(tree, child, line, search, _stack):
    block, end = leaf_blocks(tree, child)
    while block != end:
        squared = block_squared(block, line.moved)
        search = offer_lanes(squared, block, search, (None, SHIFT_32, STRIDE, PRIM_IDS))
        block += BLOCK
    return search, False


def nearest_walk(visit_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the walk of a point through a wide tree, for any leaf; see `tree_walk`."""
    return tree_walk(interval, _enter, visit_leaf)


#: The walk of a tree of triangles.
walk_triangles = nearest_walk(_visit_leaf)


@device
def _find(tree, frame, query, search, stack):
    return walk_triangles(tree, line_of(query, frame), search, stack, False)


#: The loop over points.
find_nearest = loop_of(*nearest_answer(PointSearch(_find, STACK_BYTES)))
