"""How many spheres and shapes points are in: a search for the boxes at distance 0, which counts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.primitives.nearest import SphereTree, sphere_gap
from raystream.geometry.primitives.records import SphereBlock
from raystream.geometry.shapes.nearest import in_world
from raystream.geometry.shapes.shape import shape_of
from raystream.jit.constants import ONE_F64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, mask_bits, popcount, scratch
from raystream.jit.views import address_of
from raystream.kernels.point_order import load_point
from raystream.kernels.ray import to_frame
from raystream.kernels.ray_source import loader
from raystream.kernels.shapes import KindRecord, ShapeRecord, distance_at
from raystream.structures.bvh.nearest import nearest_walk, placed_line
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.walks.single import STACK_BYTES

_HALF = 0.5

_load_local = loader(load_point, to_frame)


class _Around(NamedTuple):
    """The spheres and shapes so far, and the limit by which boxes are entered: 0."""

    limit: float
    total: float


@device
def _count_in_block(block, point, around, frame):
    """Count the spheres of a block around a point; those that it is on by half."""
    held = SphereBlock(block)
    _, length, radius = sphere_gap(point, (held.x, held.y, held.z, held.radius), frame)
    inside = np.float64(popcount(mask_bits(length < radius)))
    on = np.float64(popcount(mask_bits(length == radius)))
    return _Around(around.limit, around.total + inside + _HALF * on)


@device
def _visit_spheres(tree, child, line, around, _stack):
    return _count_in_block(leaf_address(tree.leaves, child), line.moved, around, tree), False


@device
def _count_in_shape(own, point, around, frame):
    """Count a shape around a point; by half if the point is on it."""
    if KindRecord(own.kind).distance == ZERO_U64:
        return around
    distance = distance_at(own, in_world(point, frame))
    inside = ONE_F64 if distance < ZERO_F64 else ZERO_F64
    return _Around(around.limit, around.total + (_HALF if distance == ZERO_F64 else inside))


@device
def _visit_shape(tree, child, line, around, _stack):
    return _count_in_shape(shape_of(tree.leaves, child), line.moved, around, tree), False


_walk, _walk_shapes = nearest_walk(_visit_spheres), nearest_walk(_visit_shape)


@kernel
def count_around(begin, end, points, held, frame, numbers):
    """Add the spheres and shapes around points begin to end to their winding numbers.

    Parameters
    ----------
    begin, end : int
    points : ndarray of shape (N, 3), float64
        World space, finite.
    held : PrimitiveAddresses
    frame : SceneFrame
    numbers : ndarray of shape (N,), float64
        Added to: 1 for each sphere or shape around the point, 1/2 where the point is on it.
    """
    stack = scratch(STACK_BYTES)
    tree = SphereTree(held.sphere_nodes, held.sphere_blocks, frame.center, frame.scale)
    shapes = SphereTree(held.shape_nodes, held.shapes, frame.center, frame.scale)
    for i in range(np.uint64(begin), np.uint64(end)):
        point = _load_local(address(points), i, frame)
        around = _Around(ZERO_F64, ZERO_F64)
        if held.sphere_nodes != ZERO_U64:
            line = placed_line(point, point, frame, ZERO_F64, ONE_F64)
            around = _walk(tree, line, around, stack, False)
        else:
            for k in range(held.block_count):
                block = address_of(SphereBlock(held.sphere_blocks, k))
                around = _count_in_block(block, point, around, tree)
        if held.shape_nodes != ZERO_U64:
            line = placed_line(point, point, frame, ZERO_F64, ONE_F64)
            around = _walk_shapes(shapes, line, around, stack, False)
        else:
            for k in range(held.shape_count):
                around = _count_in_shape(ShapeRecord(held.shapes, k), point, around, shapes)
        numbers[i] += around.total
