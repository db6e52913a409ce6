"""The nearest triangles of a point, with vertices in float64.

Triangles and points are in world space, in units of the local frame, which is a power of two: no
vertex is rounded, and differences are small where the point is near. Boxes are in the local frame.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.block import (
    AXIS,
    BLOCK,
    PRIM_IDS,
    SECOND,
    THIRD,
    leaf_end,
)
from raystream.jit.constants import SHIFT_64
from raystream.jit.cpu import device
from raystream.jit.simd import f64x4, load
from raystream.kernels.answers import loop_of
from raystream.kernels.nearest import triangle_rows
from raystream.kernels.point_queries import PointSearch, nearest_answer
from raystream.kernels.point_triangle import triangle_features
from raystream.structures.bvh.nearest import line_of, nearest_walk, offer_lanes
from raystream.structures.bvh.node_layout import leaf_address
from raystream.structures.bvh.walks.single import STACK_BYTES

_STRIDE = np.int32(AXIS)


class _ScaledTree(NamedTuple):
    """A `Float64Tree` by the names that walks read, and local units of a world unit."""

    nodes: np.uint64
    leaves: np.uint64
    scale: float


@device
def _corner(number, at, scale):
    corner = load(number, at), load(number, at + AXIS), load(number, at + (AXIS + AXIS))
    return corner[0] * scale, corner[1] * scale, corner[2] * scale


@device
def _corners(number, at, scale):
    """The corners of the triangle at an address, or of a block's four."""
    return (
        _corner(number, at, scale),
        _corner(number, at + SECOND, scale),
        _corner(number, at + THIRD, scale),
    )


@device
def _offer_block(block, scale, point, search):
    a, b, c = _corners(f64x4, block, scale)
    squared = triangle_features(point, a, b, c).squared
    return offer_lanes(squared, block, search, (None, SHIFT_64, _STRIDE, PRIM_IDS))


@device
def _visit_leaf(tree, child, line, search, _stack):
    block = leaf_address(tree.leaves, child)
    end = leaf_end(block, child)
    while block != end:
        search = _offer_block(block, tree.scale, line.moved, search)
        block += BLOCK
    return search, False


def tree_search(walk_of: Callable[..., Any], stack_bytes: int) -> PointSearch:
    """Make the search of the tree; see `structures.bvh.nearest.nearest_walk` for the walk."""
    walk = walk_of(_visit_leaf)

    @device
    def find_in_tree(tree, frame, query, search, stack):
        own = _ScaledTree(tree.nodes, tree.leaves, frame.scale)
        return walk(own, line_of(query, frame), search, stack, False)

    return PointSearch(find_in_tree, stack_bytes, _ROWS, True)


@device
def _find_among_all(tree, frame, query, search, stack):
    for k in range(tree.block_count):
        search = _offer_block(tree.leaves + k * BLOCK, frame.scale, query.moved, search)
    return search


@device
def _corners_of_row(view, frame, row):
    return _corners(np.float64, row.place, frame.scale)


_ROWS = triangle_rows(_corners_of_row)

#: The search over all triangles.
AMONG_ALL = PointSearch(_find_among_all, 8, _ROWS, True)

#: The loops over points, through the tree and over all triangles.
find_in_tree = loop_of(*nearest_answer(tree_search(nearest_walk, STACK_BYTES)))
find_among_all = loop_of(*nearest_answer(AMONG_ALL))
