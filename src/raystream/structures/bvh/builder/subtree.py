"""Build the binary tree over a range of references on one thread."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.simd import address, f32x8, load, scratch, store
from raystream.structures.bvh.builder.binary_tree import (
    PENDING_STACK_BYTES,
    Link,
    Pending,
    push_pending,
    put_node,
    split,
    store_sides,
)
from raystream.structures.bvh.builder.binning import BINS_BYTES, SUMS_BYTES
from raystream.structures.bvh.builder.collapse import collapse_subtree
from raystream.structures.bvh.builder.prim_refs import REF_BYTES


@kernel
def split_once(refs, begin, end, use_sides, bounds, part_bounds):
    """Split one range in two.

    Parameters
    ----------
    refs : ndarray of shape (A, 8), float32
        Those of the range are reordered.
    begin, end : int
        The range: at least two references.
    use_sides : bool
        Else the range is halved by count.
    bounds : ndarray of shape (2, 8), float32
        Boxes around the references, and around their centroids.
    part_bounds : ndarray of shape (2, 2, 8), float32
        Written: the same of both parts.

    Returns
    -------
    int
        End of the first part.
    """
    if begin == end:
        return begin
    centroids = load(f32x8, address(bounds) + np.uint64(REF_BYTES))
    middle, sides = split(
        address(refs),
        np.int32(begin),
        np.int32(end),
        centroids,
        use_sides,
        0,
        scratch(BINS_BYTES),
        scratch(SUMS_BYTES),
    )
    store_sides(address(part_bounds), sides)
    return np.int64(middle)


@kernel
def grow_subtree(tree, begin, end, depth, bounds, settings, costs, root_costs):
    """Build the binary tree over a range, and decide how it will be collapsed.

    Parameters
    ----------
    tree : BinaryTree
        References of the range are reordered. Its tree gets the rows from 2 begin on, parents
        before children.
    begin, end : int
        The range.
    depth : int
        Nodes above the range.
    bounds : ndarray of shape (2, 8), float32
        Boxes around the references, and around their centroids.
    settings : BuildSettings
    costs : ndarray of shape (2 (end - begin), 8), float32
        Scratch.
    root_costs : ndarray of shape (8,), float32
        Written: the costs of the range's root.
    """
    if begin == end:
        return
    small = settings.min_split_size
    ref_at, box_at, link_at = address(tree.refs), address(tree.boxes), address(tree.links)
    sah_depth, plain_size = settings.sah_depth, settings.plain_size
    bins, sums = scratch(BINS_BYTES), scratch(SUMS_BYTES)
    stack = scratch(PENDING_STACK_BYTES)
    root = np.int32(2 * begin)
    bound_at = address(bounds)
    put_node(box_at, link_at, root, load(f32x8, bound_at), begin, end)
    centroids = load(f32x8, bound_at + np.uint64(REF_BYTES))
    top = push_pending(stack, np.uint64(0), centroids, root, begin, end, depth)
    node_end = np.int32(root + 1)
    while top != np.uint64(0):
        top -= np.uint64(1)
        pending = Pending(stack, top)
        first, last = pending.begin, pending.end
        if last - first <= small:
            continue
        node, level = pending.node, pending.depth
        middle, sides = split(
            ref_at, first, last, pending.centroids, level < sah_depth, plain_size, bins, sums
        )
        link = Link(link_at, np.uint64(node))
        link.left, link.right = node_end, np.int32(node_end + 1)
        put_node(box_at, link_at, node_end, sides.left, first, middle)
        put_node(box_at, link_at, node_end + 1, sides.right, middle, last)
        centroids, level = sides.right_centroids, level + 1
        top = push_pending(stack, top, centroids, node_end + 1, middle, last, level)
        top = push_pending(stack, top, sides.left_centroids, node_end, first, middle, level)
        node_end = np.int32(node_end + 2)
    merged = collapse_subtree(box_at, link_at, root, node_end, settings, address(costs))
    store(address(root_costs), merged)
