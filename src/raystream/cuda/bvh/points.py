"""The nearest triangles of a point in binary nodes; see `structures.bvh.nearest` for the bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.cuda.bvh import binary
from raystream.cuda.bvh.triangles import TRIANGLE, TRIANGLE_ID, is_last
from raystream.cuda.bvh.walk import binary_walk, one_tree
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.nearest import offer_triangle
from raystream.kernels.point_queries import PointSearch
from raystream.structures.bvh.nearest import box_distances, interval, line_of

_STRIDE = np.int32(4)  # from one number of a triangle to the next

#: Bytes of a stack: links, and distances.
STACK_BYTES = 2 * binary.STACK_BYTES


@device
def _enter(box, line, search, _near, far):
    return box_distances(box, line, search, far)


def nearest_walk(visit_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the walk of a point through binary nodes, for any leaf; see `walks.single.tree_walk`."""
    walk_tree = binary_walk(interval, _enter, one_tree(visit_leaf), has_distances=True)

    @device
    def walk(tree, line, search, stack, _wants_any):
        return walk_tree(tree, line, search, stack)

    return walk


def triangle_leaf(offer: Callable[..., Any]) -> Callable[..., Any]:
    """Make a leaf of triangles; ``offer(tree, search, point, prim_id, place)`` offers one."""

    @device
    def visit_leaf(tree, link, line, search, _stack):
        at = tree.leaves + np.uint64(~link) * TRIANGLE
        while True:
            search = offer(tree, search, line.moved, load(np.int32, at + TRIANGLE_ID), at)
            if is_last(at):
                return search, False
            at += TRIANGLE

    return visit_leaf


@device
def _offer(_tree, search, point, prim_id, place):
    return offer_triangle(search, point, prim_id, place, _STRIDE)


#: The walk of a tree of triangles.
walk_triangles = nearest_walk(triangle_leaf(_offer))


@device
def _find(tree, frame, query, search, stack):
    return walk_triangles(tree, line_of(query, frame), search, stack, False)


#: The search of a point by a thread of a GPU.
POINT_SEARCH = PointSearch(_find, STACK_BYTES)
