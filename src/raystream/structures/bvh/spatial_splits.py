"""Spatial splits: references that straddle a plane are cut in two.

A long triangle makes large boxes. Where the two sides of the best object split of a range overlap,
planes are tried too: a triangle that a plane cuts gets a reference on either side, with a box
around its part there. The cheaper split is taken, if there is room: each range has spare rows for
the added references.

References
----------
Stich, Friedrich, Dietrich, "Spatial Splits in Bounding Volume Hierarchies", High Performance
Graphics 2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import (
    address,
    f32x8,
    lane,
    lanes_from_bits,
    load,
    mask8,
    maximum,
    minimum,
    scratch,
    select,
    store,
)
from raystream.structures.bvh.binary_tree import (
    PENDING_STACK_BYTES,
    Link,
    Pending,
    Span,
    halve,
    push_pending,
    put_node,
    split,
)
from raystream.structures.bvh.binning import BINS_BYTES, SUMS_BYTES, block_count
from raystream.structures.bvh.collapse import collapse_subtree
from raystream.structures.bvh.prim_refs import (
    REF_BYTES,
    centroid_bounds,
    empty_box,
    half_area,
    swap_halves,
)
from raystream.structures.bvh.spatial_bins import (
    EXIT_BYTES,
    PAD,
    SIDE_AT,
    SPATIAL_BIN_BYTES,
    clip_ref,
    find_plane,
    is_empty,
)

__all__ = ["PAD", "Space", "grow_spatially", "split_spatially"]

#: Planes are tried where the sides of the best object split overlap by more than this fraction of
#: the scene's area: elsewhere they gain little.
_OVERLAP = np.float32(1e-5)

#: And by more than this fraction of the range's own area.
_OWN_OVERLAP = np.float32(0.1)

#: A spatial split must cost less than this, relative to the object split.
_GAIN = np.float32(0.99)

#: Sides of a reference.
_LEFT, _RIGHT = np.float32(2.0), np.float32(3.0)

_ZERO = np.float32(0.0)


class Space(NamedTuple):
    """The scene, for spatial splits.

    Attributes
    ----------
    corners : ndarray of shape (F, 3, 3), float32
    pad : float32
        `PAD` in the scene's unit.
    area : float32
        Half the surface area of its box.
    """

    corners: NDArray[np.float32]
    pad: np.float32
    area: np.float32


class _Scratch(NamedTuple):
    """Addresses of memory for splits."""

    bins: np.uint64
    sums: np.uint64
    spatial_bins: np.uint64
    exits: np.uint64


class _Cutter(NamedTuple):
    """`Space` without its array: address of the corners, pad, and least overlap to try planes."""

    corners: np.uint64
    pad: np.float32
    least_overlap: np.float32


@device
def _cutter(space):
    return _Cutter(address(space.corners), np.float32(space.pad), np.float32(space.area) * _OVERLAP)


@device
def _meet(left, right):
    """Half the surface area of the intersection of two boxes; 0 if it is empty."""
    both = minimum(left, right)
    size = both + swap_halves(both)
    x, y, z = lane(size, 0), lane(size, 1), lane(size, 2)
    if x < _ZERO or y < _ZERO or z < _ZERO:
        return _ZERO
    return x * y + y * z + z * x


@device_call
def _choose_sides(refs, span, axis, position, cutter):
    """Assign each reference to a side, and cut those that straddle the plane.

    Returns the new end of the references.
    """
    begin, end, limit = span.begin, span.end, span.limit
    left, right = scratch(REF_BYTES), scratch(REF_BYTES)
    axis_at = np.uint64(axis) * np.uint64(4)
    for i in range(np.uint64(begin), np.uint64(end)):
        at = refs + i * np.uint64(REF_BYTES)
        low = -load(np.float32, at + axis_at)
        high = load(np.float32, at + axis_at + np.uint64(16))
        goes_left = low + high < position + position
        if low < position and high > position and end < limit:
            clip_ref(at, cutter.corners, np.uint64(axis), position, cutter.pad, left, right)
            if not is_empty(left) and not is_empty(right):
                store(at, load(f32x8, left))
                added = refs + np.uint64(end) * np.uint64(REF_BYTES)
                store(added, load(f32x8, right))
                store(added + np.uint64(SIDE_AT), _RIGHT)
                end = np.int32(end + np.int32(1))
                goes_left = True
        store(at + np.uint64(SIDE_AT), _LEFT if goes_left else _RIGHT)
    return end


@device
def _partition_by_side(refs, begin, end):
    """Move the references of the left side to the front; returns the same as `partition`."""
    nothing, not_last = empty_box(), lanes_from_bits(mask8, 127)
    one = f32x8(np.float32(1.0))
    left, left_centroids, right, right_centroids = nothing, nothing, nothing, nothing
    at = refs + np.uint64(begin) * np.uint64(REF_BYTES)
    last = refs + np.uint64(end) * np.uint64(REF_BYTES)
    border = at
    while at != last:
        ref = load(f32x8, at)
        goes_left = lane(ref, 7) == _LEFT
        ref = select(not_last, ref, one)
        centroid = centroid_bounds(ref)
        store(at, load(f32x8, border))
        store(border, ref)
        if goes_left:
            left, left_centroids = maximum(left, ref), maximum(left_centroids, centroid)
            border += np.uint64(REF_BYTES)
        else:
            right, right_centroids = maximum(right, ref), maximum(right_centroids, centroid)
        at += np.uint64(REF_BYTES)
    middle_row = np.int32((border - refs) >> np.uint64(5))
    return middle_row, left, left_centroids, right, right_centroids


@device
def _split(refs, span, box, centroids, use_sides, tries, cutter, memory):
    """Split a range in two by the cheaper of an object split and a spatial split.

    Parameters
    ----------
    refs : uint64
        Address of all references.
    span : Span
    box : uint64
        Address of the range's box.
    centroids : f32x8
        Bounds of the references' centroids.
    use_sides : bool
        Else halve it by count.
    tries : bool
        Whether to try spatial splits.
    cutter : _Cutter
    memory : _Scratch

    Returns
    -------
    left_end, right_begin, right_end : int32
        The references of the parts; the left one's rows end where the right one begins.
    left, left_centroids, right, right_centroids : f32x8
    """
    begin, end, limit = span.begin, span.end, span.limit
    middle, left, left_centroids, right, right_centroids = split(
        refs, begin, end, centroids, use_sides, 0, memory.bins, memory.sums
    )
    overlap = _meet(left, right)
    overlaps = (
        overlap > cutter.least_overlap and overlap > half_area(load(f32x8, box)) * _OWN_OVERLAP
    )
    if use_sides and tries and limit > end and overlaps:
        cost = half_area(left) * block_count(middle - begin)
        cost += half_area(right) * block_count(end - middle)
        axis, position, plane_cost, cut_count = find_plane(
            refs, begin, end, box, cutter.corners, cutter.pad, memory.spatial_bins, memory.exits
        )
        if plane_cost < cost * _GAIN and cut_count <= limit - end:
            end = _choose_sides(refs, span, axis, position, cutter)
            middle, left, left_centroids, right, right_centroids = _partition_by_side(
                refs, begin, end
            )
            if middle in (begin, end):
                middle, left, left_centroids, right, right_centroids = halve(refs, begin, end)
    right_begin, right_end = middle, end
    if tries and limit > end:
        # Divide spare rows in proportion to the sizes: the right side moves up.
        spare = np.int64(limit - end) * np.int64(middle - begin) // np.int64(end - begin)
        moved = min(np.int32(spare), np.int32(end - middle))
        source = refs + np.uint64(middle) * np.uint64(REF_BYTES)
        target = refs + np.uint64(end + np.int32(spare) - moved) * np.uint64(REF_BYTES)
        for i in range(np.uint64(moved)):
            store(
                target + i * np.uint64(REF_BYTES),
                load(f32x8, source + i * np.uint64(REF_BYTES)),
            )
        right_begin = np.int32(middle + np.int32(spare))
        right_end = np.int32(end + np.int32(spare))
    return middle, right_begin, right_end, left, left_centroids, right, right_centroids


@kernel
def split_spatially(refs, span, use_sides, bounds, space, part_bounds, ends):
    """Split one range in two.

    Parameters
    ----------
    refs : ndarray of shape (A, 8), float32
        Those of the range are reordered, and some added.
    span : Span
        At least two references.
    use_sides : bool
        Else it is halved by count.
    bounds : ndarray of shape (2, 8), float32
        Boxes around the references, and around their centroids.
    space : Space
    part_bounds : ndarray of shape (2, 2, 8), float32
        Written: the bounds of both parts.
    ends : ndarray of shape (3,), int64
        Written: the end of the left part, and begin and end of the right one.
    """
    if span.begin == span.end:
        return
    bound_at = address(bounds)
    left_end, right_begin, right_end, left, left_centroids, right, right_centroids = _split(
        address(refs),
        Span(np.int32(span.begin), np.int32(span.end), np.int32(span.limit)),
        bound_at,
        load(f32x8, bound_at + np.uint64(REF_BYTES)),
        use_sides,
        True,
        _cutter(space),
        _Scratch(
            scratch(BINS_BYTES),
            scratch(SUMS_BYTES),
            scratch(SPATIAL_BIN_BYTES),
            scratch(EXIT_BYTES),
        ),
    )
    to = address(part_bounds)
    store(to, left)
    store(to + np.uint64(REF_BYTES), left_centroids)
    store(to + np.uint64(2 * REF_BYTES), right)
    store(to + np.uint64(3 * REF_BYTES), right_centroids)
    ends[0], ends[1], ends[2] = left_end, right_begin, right_end


@kernel
def grow_spatially(tree, span, depth, bounds, space, settings, costs, root_costs):
    """Build the binary tree over a range with spatial splits; see `grow_subtree`."""
    begin, end, limit = span.begin, span.end, span.limit
    if begin == end:
        return
    small, max_leaf_size = settings.min_split_size, settings.max_leaf_size
    ref_at, box_at, link_at = address(tree.refs), address(tree.boxes), address(tree.links)
    memory = _Scratch(
        scratch(BINS_BYTES), scratch(SUMS_BYTES), scratch(SPATIAL_BIN_BYTES), scratch(EXIT_BYTES)
    )
    cutter = _cutter(space)
    stack = scratch(PENDING_STACK_BYTES)
    root = np.int32(2 * begin)
    bound_at = address(bounds)
    put_node(box_at, link_at, root, load(f32x8, bound_at), begin, end)
    centroids = load(f32x8, bound_at + np.uint64(REF_BYTES))
    top = push_pending(stack, np.uint64(0), centroids, root, begin, end, depth, limit)
    node_end = np.int32(root + 1)
    while top != np.uint64(0):
        top -= np.uint64(1)
        pending = Pending(stack, top)
        first, last = pending.begin, pending.end
        if last - first <= small:
            continue
        room, node, level = pending.limit, pending.node, pending.depth
        # A range that may become one leaf stays together, without spare rows in between.
        tries = last - first > max_leaf_size
        left_end, right_begin, right_end, left, left_centroids, right, right_centroids = _split(
            ref_at,
            Span(first, last, room),
            box_at + np.uint64(node) * np.uint64(REF_BYTES),
            pending.centroids,
            level < settings.sah_depth,
            tries,
            cutter,
            memory,
        )
        link = Link(link_at, np.uint64(node))
        link.left, link.right = node_end, np.int32(node_end + 1)
        put_node(box_at, link_at, node_end, left, first, left_end)
        put_node(box_at, link_at, node_end + 1, right, right_begin, right_end)
        top = push_pending(
            stack, top, right_centroids, node_end + 1, right_begin, right_end, level + 1, room
        )
        top = push_pending(
            stack, top, left_centroids, node_end, first, left_end, level + 1, right_begin
        )
        node_end = np.int32(node_end + 2)
    merged = collapse_subtree(box_at, link_at, root, node_end, settings, address(costs))
    store(address(root_costs), merged)
