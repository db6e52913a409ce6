"""Building the tree over a range of triangles on one thread."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, device_call, kernel
from raystream.structures.bvh.binning import (
    BIN_COUNT,
    bounds_of,
    find_split,
    half_area,
    partition,
)
from raystream.structures.bvh.layout import MAX_DEPTH

__all__ = ["SAH_DEPTH", "build_subtree", "split_range", "triangle_boxes"]

#: From this depth on ranges are halved by count: at most 31 more levels are then needed
#: for any number of triangles that prim_id can name.
SAH_DEPTH = MAX_DEPTH - 32

#: Cost of visiting a node, in triangle tests, for the surface area heuristic.
_TRAVERSAL_COST = np.float32(1.0)


class _Scratch(NamedTuple):
    bin_boxes: object
    bin_counts: object
    right_costs: object
    middles: object


@device
def _make_scratch():
    return _Scratch(
        np.empty((3, BIN_COUNT, 2, 3), np.float32),
        np.empty((3, BIN_COUNT), np.int64),
        np.empty(BIN_COUNT, np.float32),
        np.empty((2, 3), np.float32),
    )


@kernel
def triangle_boxes(begin, end, corners, source_ids, prim_ids, boxes):
    """Fill rows begin to end of `boxes`, (A, 2, 3), and `prim_ids` from the triangles to build."""
    for i in range(np.uint64(begin), np.uint64(end)):
        prim_id = source_ids[i]
        prim_ids[i] = prim_id
        triangle = corners[np.uint64(prim_id)]
        for axis in range(3):
            a, b, c = triangle[0, axis], triangle[1, axis], triangle[2, axis]
            boxes[i, 0, axis] = min(a, b, c)
            boxes[i, 1, axis] = max(a, b, c)


@device_call
def _split(boxes, prim_ids, begin, end, depth, max_leaf_size, bounds, scratch):
    """Split a range in two; returns the end of the first part, or `begin` to make a leaf.

    Writes the range's bounds.
    """
    count = end - begin
    bounds_of(boxes, begin, end, bounds, scratch.middles)
    if count <= 1:
        return begin
    axis = -1
    if depth < SAH_DEPTH:
        axis, position, cost = find_split(
            boxes,
            begin,
            end,
            scratch.middles,
            scratch.bin_boxes,
            scratch.bin_counts,
            scratch.right_costs,
        )
        area = half_area(bounds)
        leaf_cost = area * np.float32(count)
        if count <= max_leaf_size and leaf_cost <= cost + _TRAVERSAL_COST * area:
            return begin
        if axis >= 0:
            return partition(boxes, prim_ids, begin, end, scratch.middles, axis, position)
    # Nothing tells the triangles apart, or the tree is too deep: halve them by count.
    return begin if count <= max_leaf_size else begin + count // 2


@kernel
def split_range(boxes, prim_ids, begin, end, depth, max_leaf_size, bounds):
    """Split one large range; see `_split`."""
    return _split(boxes, prim_ids, begin, end, depth, max_leaf_size, bounds, _make_scratch())


# Assigning whole rows (a[i] = b) makes Numba compile shape checks with error messages, 20
# seconds' worth in build_subtree; hence the loops over elements below.


@device
def _set_child(node_boxes, children, node, child, index, count, bounds):
    for axis in range(3):
        node_boxes[node, child, 0, axis] = bounds[0, axis]
        node_boxes[node, child, 1, axis] = bounds[1, axis]
    children[node, child, 0] = index
    children[node, child, 1] = count


@device
def _set_pending(pending, size, first, last, level, node, child):
    pending[size, 0] = first
    pending[size, 1] = last
    pending[size, 2] = level
    pending[size, 3] = node
    pending[size, 4] = child


@kernel
def build_subtree(
    boxes, prim_ids, begin, end, depth, max_leaf_size, node_boxes, children, root_bounds
):
    """Build all of the tree over a range.

    Parameters
    ----------
    boxes, prim_ids : ndarray of shape (A, 2, 3), float32, and (A,), int32
        Triangles; those of the range are reordered.
    begin, end : int
        The range; leaves refer to its rows.
    depth : int
        Nodes above the range.
    max_leaf_size : int
    node_boxes, children : ndarray of shape (K, 2, 2, 3), float32, and (K, 2, 2), int32
        Written from row 0, parents before their children; room for end - begin nodes.
    root_bounds : ndarray of shape (2, 3), float32
        Written: the bounds of the range.

    Returns
    -------
    int
        Number of nodes written; 0 if the whole range is to be one leaf.
    """
    scratch = _make_scratch()
    # A pending range: its rows, its depth, and the child (of a node) that it will become.
    pending = np.empty((MAX_DEPTH + 2, 5), np.int64)
    middle = _split(boxes, prim_ids, begin, end, depth, max_leaf_size, root_bounds, scratch)
    if middle == begin:
        return 0
    bounds = np.empty((2, 3), np.float32)
    node_count = 1
    _set_pending(pending, 0, middle, end, depth + 1, 0, 1)
    _set_pending(pending, 1, begin, middle, depth + 1, 0, 0)
    size = 2
    while size > 0:
        size -= 1
        first, last, level = pending[size, 0], pending[size, 1], pending[size, 2]
        parent, child = pending[size, 3], pending[size, 4]
        middle = _split(boxes, prim_ids, first, last, level, max_leaf_size, bounds, scratch)
        if middle == first:
            _set_child(node_boxes, children, parent, child, first, last - first, bounds)
            continue
        node = node_count
        node_count += 1
        _set_child(node_boxes, children, parent, child, node, 0, bounds)
        _set_pending(pending, size, middle, last, level + 1, node, 1)
        _set_pending(pending, size + 1, first, middle, level + 1, node, 0)
        size += 2
    return node_count
