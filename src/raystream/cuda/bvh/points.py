"""The nearest triangles of a point in binary nodes; see `structures.bvh.nearest` for the bounds."""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.binary import STACK_BYTES
from raystream.cuda.bvh.triangles import TRIANGLE, TRIANGLE_ID, is_last
from raystream.cuda.bvh.walk import binary_walk, one_tree
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.nearest import offer_triangle
from raystream.kernels.point_queries import PointSearch
from raystream.structures.bvh.nearest import far_distance, interval, line_of, near_distance

_STRIDE = np.int32(4)  # from one number of a triangle to the next


@device
def _enter(box, line, search, _near, far):
    if line.is_far:
        squared = far_distance(box, line)
        return np.float32(squared), squared <= search.limit
    distance = near_distance(box, line)
    return distance, distance <= far


@device
def _visit_leaf(tree, link, line, search, _stack):
    at = tree.leaves + np.uint64(~link) * TRIANGLE
    while True:
        prim_id = load(np.int32, at + TRIANGLE_ID)
        search = offer_triangle(search, line.moved, prim_id, at, _STRIDE)
        if is_last(at):
            return search, False
        at += TRIANGLE


_walk = binary_walk(interval, _enter, one_tree(_visit_leaf), has_distances=True)


@device
def _find(tree, frame, query, search, stack):
    return _walk(tree, line_of(query, frame), search, stack)


#: The search of a point by a thread of a GPU.
POINT_SEARCH = PointSearch(_find, 2 * STACK_BYTES)
