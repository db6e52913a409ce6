"""The nearest triangles, height fields, spheres and shapes of a point: one search through all.

A sphere's distance is the difference between its radius and the distance of its centre, in float64.
A shape's is what its user's function says, but at least that of its box: trees leave out none.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.fields.cells import (
    PACKET_BYTES,
    corners_of_number,
    field_walk,
    fill_row,
)
from raystream.geometry.primitives.records import SPHERES_PER_BLOCK, FieldRecord, SphereBlock
from raystream.geometry.shapes.nearest import shape_foot, shape_squared
from raystream.geometry.shapes.shape import shape_of
from raystream.geometry.spheres.sphere import octahedral
from raystream.jit.constants import ONE_F64, SHIFT_32, SHIFT_64, ZERO_F32, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    bits_as_float,
    float_as_bits,
    load,
    mask_bits,
    square_root,
    store,
)
from raystream.jit.views import address_of
from raystream.kernels.answers import loop_of
from raystream.kernels.leaf_block import BLOCK, PRIM_IDS
from raystream.kernels.nearest import RowShape, corners_at, offer_squared
from raystream.kernels.point_queries import PointSearch, nearest_answer
from raystream.kernels.point_triangle import Foot, foot_of, triangle_features
from raystream.kernels.shapes import ShapeRecord
from raystream.kernels.vectors import dot
from raystream.structures.brute.nearest import offer_all
from raystream.structures.bvh.nearest import (
    block_squared,
    box_distances,
    interval,
    line_of,
    nearest_walk,
    offer_lanes,
    walk_triangles,
)
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.walks.single import STACK_BYTES

_CELLS = np.uint64(4)

#: Strides of `kernels.nearest.ROW`: of a sphere, bytes between its numbers; of a triangle of a
#: height field, whose place is its field's; and of a shape.
_SPHERE, _FIELD, _SHAPE = np.int32(8 * SPHERES_PER_BLOCK), np.int32(-1), np.int32(-2)

#: Where a block of spheres has their numbers.
_NUMBERS = np.uint64(4 * 8 * SPHERES_PER_BLOCK)


class SphereTree(NamedTuple):
    """A tree of spheres or shapes, by the names that walks read, and the scene's frame."""

    nodes: np.uint64
    leaves: np.uint64
    center: tuple[float, float, float]
    scale: float


# Spheres


@device
def sphere_gap(point, sphere, frame):
    """The vector from a sphere's centre to a point, its length, and the radius; local frame."""
    center, scale = frame.center, frame.scale
    x = point[0] - (sphere[0] - center[0]) * scale
    y = point[1] - (sphere[1] - center[1]) * scale
    z = point[2] - (sphere[2] - center[2]) * scale
    return (x, y, z), square_root(dot((x, y, z), (x, y, z))), sphere[3] * scale


@device
def _sphere_squared(point, sphere, frame):
    _, length, radius = sphere_gap(point, sphere, frame)
    return (length - radius) * (length - radius)


@device
def _offer_spheres(block, point, search, frame):
    """Offer the spheres of a block."""
    held = SphereBlock(block)
    squared = _sphere_squared(point, (held.x, held.y, held.z, held.radius), frame)
    return offer_lanes(squared, block, search, (None, SHIFT_64, _SPHERE, _NUMBERS))


@device
def _visit_spheres(tree, child, line, search, _stack):
    return _offer_spheres(leaf_address(tree.leaves, child), line.moved, search, tree), False


@device
def _sphere_at(row):
    at, step = row.place, np.uint64(_SPHERE)
    return (
        load(np.float64, at),
        load(np.float64, at + step),
        load(np.float64, at + (step + step)),
        load(np.float64, at + (step + step + step)),
    )


@device
def _sphere_foot(point, sphere, frame):
    """The nearest point of a sphere; of its centre, the top: that in direction z."""
    (x, y, z), length, radius = sphere_gap(point, sphere, frame)
    u, v = octahedral(x, y, z)
    if length == ZERO_F64:
        x, y, z, length = ZERO_F64, ZERO_F64, ONE_F64, ONE_F64
    ratio = radius / length
    squared = _sphere_squared(point, sphere, frame)
    at_x = (sphere[0] - frame.center[0]) * frame.scale + x * ratio
    at_y = (sphere[1] - frame.center[1]) * frame.scale + y * ratio
    at_z = (sphere[2] - frame.center[2]) * frame.scale + z * ratio
    return Foot(squared, at_x, at_y, at_z, np.float64(u), np.float64(v))


# Shapes


@device
def _offer_shape(own, point, search, frame):
    squared, place = shape_squared(own, point, frame), address_of(own)
    return offer_squared(search, squared, own.number, place, _SHAPE)


@device
def _visit_shape(tree, child, line, search, _stack):
    return _offer_shape(shape_of(tree.leaves, child), line.moved, search, tree), False


# Height fields


@device
def _take(key, level, line, search):  # noqa: ARG001
    return bits_as_float(key) <= interval(line, search)[1]


@device
def _enter(boxes, key, line, search, keys):  # noqa: ARG001
    """Find the nodes within the limit; their keys are the distances."""
    low, high = boxes
    box = low[0], high[0], low[1], high[1], low[2], high[2]
    distances, entered = box_distances(box, line, search, interval(line, search)[1])
    store(keys, distances)
    return mask_bits(entered)


@device
def _offer_row(field, place, key, line, search, blocks):  # noqa: ARG001
    """Offer the triangles of four cells of a row."""
    fill_row(field, place[0], place[1], blocks)
    for half in range(np.uint64(2)):
        block = blocks + half * BLOCK
        rows = address_of(field), SHIFT_32, _FIELD, PRIM_IDS
        search = offer_lanes(block_squared(block, line.moved), block, search, rows)
    return search, False


_walk_field = field_walk(_take, _enter, _offer_row)


# Both, with triangles


@device
def _corners(row):
    if row.stride == _FIELD:
        return corners_of_number(FieldRecord(row.place), row.prim_id)
    return corners_at(row.place, row.stride)


@device
def _measure(view, frame, point, row):  # noqa: ARG001
    if row.stride == _SPHERE:
        return _sphere_squared(point, _sphere_at(row), frame)
    a, b, c = _corners(row)
    return triangle_features(point, a, b, c).squared


@device
def _foot(view, frame, point, row):  # noqa: ARG001
    if row.stride == _SPHERE:
        return _sphere_foot(point, _sphere_at(row), frame)
    a, b, c = _corners(row)
    return foot_of(triangle_features(point, a, b, c), a, b, c)


@device
def _measure_any(view, frame, point, row):
    if row.stride == _SHAPE:
        return shape_squared(ShapeRecord(row.place), point, frame)
    return _measure(view, frame, point, row)


@device
def _foot_any(view, frame, point, row):
    if row.stride == _SHAPE:
        return shape_foot(ShapeRecord(row.place), point, frame)
    return _foot(view, frame, point, row)


#: Of all primitives but shapes, whose functions devices do not have; and of all.
_ROWS, _ALL_ROWS = RowShape(_measure, _foot), RowShape(_measure_any, _foot_any)


@device
def _no_shapes(tree, line, search, stack, wants_any):  # noqa: ARG001
    return search


def trees_search(
    walk_triangles: Callable[..., Any],
    walk_of: Callable[..., Any],
    stack_bytes: int,
    rows: RowShape = _ROWS,
) -> PointSearch:
    """Make the search of the trees; see `structures.bvh.nearest.nearest_walk` for the walks.

    `rows` is of what is searched; by default, shapes are not.
    """
    walk_spheres = walk_of(_visit_spheres)
    walk_shapes = walk_of(_visit_shape) if rows is _ALL_ROWS else _no_shapes

    @device
    def find_in_trees(held, frame, query, search, stack):
        line = line_of(query, frame)
        search = walk_triangles(held, line, search, stack, False)
        for k in range(held.field_count):
            field = FieldRecord(held.fields, k)
            key = float_as_bits(ZERO_F32)
            search = _walk_field(field, (False, False), key, line, search, stack)
        tree = SphereTree(held.sphere_nodes, held.sphere_blocks, frame.center, frame.scale)
        search = walk_spheres(tree, line, search, stack, False)
        tree = SphereTree(held.shape_nodes, held.shapes, frame.center, frame.scale)
        return walk_shapes(tree, line, search, stack, False)

    return PointSearch(find_in_trees, max(stack_bytes, PACKET_BYTES), rows)


@device
def _find_among_all(held, frame, query, search, stack):
    search = offer_all(held, frame, query, search, stack)
    line = line_of(query, frame)
    for k in range(held.field_count):
        field = FieldRecord(held.fields, k)
        for row in range(field.rows):
            column = ZERO_U64
            while column < field.columns:
                search, _ = _offer_row(field, (row, column), None, line, search, stack)
                column += _CELLS
    for k in range(held.block_count):
        block = address_of(SphereBlock(held.sphere_blocks, k))
        search = _offer_spheres(block, query.moved, search, frame)
    for k in range(held.shape_count):
        search = _offer_shape(ShapeRecord(held.shapes, k), query.moved, search, frame)
    return search


#: The search over all primitives.
AMONG_ALL = PointSearch(_find_among_all, PACKET_BYTES, _ALL_ROWS)

#: The loops over points, through the trees and over all primitives.
_IN_TREES = trees_search(walk_triangles, nearest_walk, STACK_BYTES, _ALL_ROWS)
find_in_trees = loop_of(*nearest_answer(_IN_TREES))
find_among_all = loop_of(*nearest_answer(AMONG_ALL))
