"""The nearest triangles of a point among instances, by distance in world space.

An object's tree is searched with the point in object space. A transform shortens no distance by
more than its smallest singular value, so that distances of boxes there bound those of the
triangles. The corners of triangles are moved to world space in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.jit.constants import SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import f32x4, load, widen
from raystream.jit.views import view
from raystream.kernels.answers import loop_of
from raystream.kernels.leaf_block import AXIS, BLOCK, PRIM_IDS, SECOND, THIRD, TRIANGLE_BYTES
from raystream.kernels.nearest import RowShape, corners_at, offer_squared, triangle_rows
from raystream.kernels.point_queries import PointSearch, nearest_answer
from raystream.kernels.point_triangle import triangle_features
from raystream.kernels.ray import largest
from raystream.structures.base import Structure
from raystream.structures.bvh.nearest import (
    STRIDE,
    line_of,
    nearest_walk,
    offer_lanes,
    placed_line,
)
from raystream.structures.bvh.steps import leaf_blocks
from raystream.structures.bvh.walks.single import STACK_BYTES

_LEAF_SHIFT = np.int32(3)
_ALL_STRIDE = np.int32(4)

#: A point moved to object space, and a corner moved to world space, are wrong by at most this much
#: of the terms' lengths, times the condition number: some 2**-50, with a margin.
_ROUNDING = 2.0**-46

#: Singular values are computed within less than this much of the largest one.
_SINGULAR = 2.0**-46

#: Addresses of the object's structure, see `records.OBJECT_ADDRESSES`.
_ADDRESSES = ("nodes", "leaves", "references", "corners", "triangle_count")

#: An instance: object space to world space, and back, between the local frame of the object and
#: world space in units of the scene's; squared local distances of squared world distances, at most;
#: the error of a point in object space, for its largest coordinate and `reach` together.
_PLACED: list[Any] = [
    ("to_world", "f8", (3, 3)),
    ("world_shift", "f8", 3),
    ("to_object", "f8", (3, 3)),
    ("object_shift", "f8", 3),
    ("unit", "f8"),
    ("error", "f8"),
    ("reach", "f8"),
    *((name, "u8") for name in _ADDRESSES),
    ("max_coordinate", "f4"),
    ("first_id", "i4"),
]
PlacedRecord = view(_PLACED)


class PlacedInstances(NamedTuple):
    """The instances of a scene, for points.

    Attributes
    ----------
    nodes : uint64
        The root of the tree over the instances; 0 without one.
    leaves : uint64
        The first `PlacedRecord`.
    instance_count : uint64
    """

    nodes: np.uint64
    leaves: np.uint64
    instance_count: np.uint64


class _ObjectTree(NamedTuple):
    """The tree of an instance's object, by the names that walks read; and its number."""

    nodes: np.uint64
    leaves: np.uint64
    placed: np.uint64
    number: np.uint64


def _norm(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    norms: NDArray[np.float64] = np.abs(matrices).sum(axis=2).max(axis=1, initial=0.0)
    return norms


def placed_records(
    triangles: InstancedTriangles,
    objects: Sequence[Structure],
    order: NDArray[np.integer],
    scale: float,
) -> NDArray[np.void]:
    """The `PlacedRecord` of some instances, in an order; the caller keeps the objects alive."""
    instances = triangles.instances
    ids = instances.object_ids[order]
    records = np.zeros(len(order), _PLACED)
    views = [one.view._asdict() for one in objects]
    for name in _ADDRESSES:
        table = np.array([held.get(name, 0) for held in views], np.uint64)
        records[name] = table[ids]
    stores = triangles.objects
    scales = np.array([one.scale for one in stores])[ids]
    centers = np.array([one.center for one in stores]).reshape(-1, 3)[ids]
    reaches = np.array([float(one.max_coordinate) for one in stores])[ids]
    forward, back = instances.transforms[order], instances.inverses[order]
    # Step 1: both ways, with the frames' scales, which are powers of two.
    to_world = forward[:, :, :3] * (scale / scales)[:, None, None]
    to_object = back[:, :, :3] * (scales / scale)[:, None, None]
    moved_centers = np.einsum("kij,kj->ki", forward[:, :, :3], centers)
    records["to_world"], records["to_object"] = to_world, to_object
    records["world_shift"] = (moved_centers + forward[:, :, 3]) * scale
    records["object_shift"] = (back[:, :, 3] - centers) * scales[:, None]
    # Step 2: bounds.
    singular = np.linalg.svd(to_world, compute_uv=False)
    least = singular[:, 2] - _SINGULAR * singular[:, 0]
    records["unit"] = (1.0 + 2.0**-40) / (least * least)
    records["error"] = _ROUNDING * instances.conditions[order] * _norm(to_object)
    shifts = np.abs(forward[:, :, 3]).max(axis=1, initial=0.0) * scale
    inside = np.abs(centers).max(axis=1, initial=0.0) * scales + reaches
    records["reach"] = shifts + _norm(to_world) * inside
    records["max_coordinate"] = reaches
    records["first_id"] = triangles.first_ids[order]
    return records


def placed_view(nodes: NDArray[np.float32], records: NDArray[np.void]) -> PlacedInstances:
    """The view of a tree and its records, which the caller keeps alive."""
    at = np.uint64(nodes.ctypes.data if len(nodes) else 0)
    return PlacedInstances(at, np.uint64(records.ctypes.data), np.uint64(len(records)))


@device
def _row(matrix, shift, p):
    return matrix[0] * p[0] + matrix[1] * p[1] + matrix[2] * p[2] + shift


@device
def _product(matrix, shift, p):
    """A point, or points side by side, moved by a transform."""
    return (
        _row(matrix[np.uint64(0)], shift[0], p),
        _row(matrix[np.uint64(1)], shift[1], p),
        _row(matrix[np.uint64(2)], shift[2], p),
    )


@device
def _in_world(placed, a, b, c):
    """Corners in world space."""
    matrix, shift = placed.to_world, placed.world_shift
    return _product(matrix, shift, a), _product(matrix, shift, b), _product(matrix, shift, c)


@device
def _corner(at):
    x, y, z = load(f32x4, at), load(f32x4, at + AXIS), load(f32x4, at + (AXIS + AXIS))
    return widen(x), widen(y), widen(z)


@device
def _visit_block(tree, child, line, search, _stack):
    """Offer the triangles of an object's leaf."""
    placed = PlacedRecord(tree.placed, tree.number)
    rows = None, SHIFT_32, np.int32(tree.number), PRIM_IDS
    block, end = leaf_blocks(tree, child)
    while block != end:
        corners = _corner(block), _corner(block + SECOND), _corner(block + THIRD)
        a, b, c = _in_world(placed, *corners)
        squared = triangle_features(line.moved, a, b, c).squared
        search = offer_lanes(squared, block, search, rows, placed.first_id)
        block += BLOCK
    return search, False


@device
def offer_placed(tree, search, point, prim_id, place):
    """Offer the triangle at a place, whose numbers are adjacent, of an `_ObjectTree`'s instance."""
    placed = PlacedRecord(tree.placed, tree.number)
    a, b, c = _in_world(placed, *corners_at(place, _ALL_STRIDE))
    squared = triangle_features(point, a, b, c).squared
    number = np.int32(prim_id + placed.first_id)
    return offer_squared(search, squared, number, place, np.int32(tree.number))


@device
def _find_among_all(top, frame, query, search, stack):  # noqa: ARG001
    for index in range(top.instance_count):
        placed = PlacedRecord(top.leaves, index)
        tree = _ObjectTree(placed.nodes, placed.leaves, top.leaves, index)
        for k in range(placed.triangle_count):
            prim_id = load(np.int32, placed.references + (k << SHIFT_32))
            place = placed.corners + np.uint64(prim_id) * TRIANGLE_BYTES
            search = offer_placed(tree, search, query.moved, prim_id, place)
    return search


def _rows(stride: np.int32) -> RowShape:
    """Rows of triangles whose numbers are some bytes apart; their strides are the instances."""

    @device
    def corners(top, frame, row):  # noqa: ARG001
        placed = PlacedRecord(top.leaves, np.uint64(row.stride))
        return _in_world(placed, *corners_at(row.place, stride))

    return triangle_rows(corners)


#: Rows of triangles whose numbers are adjacent, see `offer_placed`.
ADJACENT = _rows(_ALL_STRIDE)


def trees_search(
    visit_leaf: Callable[..., Any],
    rows: RowShape,
    walk_of: Callable[..., Any],
    stack_bytes: int,
) -> PointSearch:
    """Make the search of the trees.

    Parameters
    ----------
    visit_leaf : device function
        Offers the triangles of a leaf of an `_ObjectTree`.
    rows : RowShape
        Of these.
    walk_of : callable
        Makes the walks; see `structures.bvh.nearest.nearest_walk`.
    stack_bytes : int
        Of a walk.
    """
    stack_size, walk_object = np.uint64(stack_bytes), walk_of(visit_leaf)

    @device
    def visit_instance(tree, child, line, search, stack):
        """Search the object of an instance."""
        index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
        placed = PlacedRecord(tree.leaves, index)
        point = _product(placed.to_object, placed.object_shift, line.moved)
        slack = placed.error * (largest(line.moved) + placed.reach)
        own = placed_line(point, line.moved, placed, slack, placed.unit)
        inner = _ObjectTree(placed.nodes, placed.leaves, tree.leaves, index)
        return walk_object(inner, own, search, stack + stack_size, False), False

    walk_instances = walk_of(visit_instance)

    @device
    def find_in_trees(top, frame, query, search, stack):
        return walk_instances(top, line_of(query, frame), search, stack, False)

    return PointSearch(find_in_trees, 2 * stack_bytes, rows, True)


_SEARCH = trees_search(_visit_block, _rows(STRIDE), nearest_walk, STACK_BYTES)

#: The search over all triangles of all instances.
AMONG_ALL = PointSearch(_find_among_all, 8, ADJACENT, True)

#: The loops over points, through the trees and over all triangles of all instances.
find_in_trees = loop_of(*nearest_answer(_SEARCH))
find_among_all = loop_of(*nearest_answer(AMONG_ALL))
