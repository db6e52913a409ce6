"""The binary tree that the builder makes first: its arrays, and how ranges are split.

A binary tree over A references has up to 2 A - 1 nodes. Those of the references from b to e lie
within rows 2 b to 2 e - 1, so that threads fill the tree without synchronising.

A node's box is a row of eight float32 like a ref: -low x, y, z, first ref (int32 bits);
high x, y, z, ref count (int32 bits). Its links are a row of four int32: left child, right
child, and what `collapse` decides; the left child of a leaf is -1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device
from raystream.jit.simd import (
    f32x4,
    f32x8,
    lane,
    lanes_from_bits,
    load,
    mask4,
    mask8,
    mask_bits,
    maximum,
    select,
    store,
)
from raystream.jit.views import view
from raystream.structures.bvh.builder.binning import (
    BIN_COUNT,
    bin_frame,
    bin_refs,
    clear_bins,
    find_split,
)
from raystream.structures.bvh.builder.prim_refs import (
    COUNT_AT,
    FIRST_AT,
    REF_BYTES,
    centroid_bounds,
    empty_box,
    high_half,
    low_half,
)

_LINK = np.dtype([("left", "i4"), ("right", "i4"), ("decision", "i4"), ("is_top", "i4")])
Link = view(_LINK)
LINK_BYTES = _LINK.itemsize
LINK_INTS = LINK_BYTES // 4

#: Nodes on the longest path: halving by count takes at most 31 levels for any number of triangles
#: that prim_id can number.
MAX_TREE_DEPTH = 128
HALVING_LEVELS = 32

#: A pending range on a builder's stack.
_PENDING = np.dtype(
    [
        ("centroids", "f4", 8),  # bounds of its references' centroids
        ("node", "i4"),
        ("begin", "i4"),
        ("end", "i4"),
        ("depth", "i4"),
        ("unused", "V16"),
    ]
)
Pending = view(_PENDING)
PENDING_STACK_BYTES = (MAX_TREE_DEPTH + 2) * _PENDING.itemsize


class BinaryTree(NamedTuple):
    """Arrays of a binary tree over A references.

    Attributes
    ----------
    refs : ndarray of shape (A, 8), float32
        See `prim_refs`.
    boxes, links : ndarray of shape (2 A, 8), float32, and (2 A, 4), int32
    """

    refs: NDArray[np.float32]
    boxes: NDArray[np.float32]
    links: NDArray[np.int32]


class BuildSettings(NamedTuple):
    """How to build a binary tree.

    Attributes
    ----------
    min_split_size : int
        Ranges of at most this many references are not split.
    plain_size : int
        Those of at most this many are split in the middle, others by the surface area heuristic.
    max_leaf_size : int
        Most references in a leaf.
    sah_depth : int
        From this depth on ranges are halved by count.
    costs : tuple of three float32
        Relative times of a node step and of the test of a block of 4 triangles, to be multiplied by
        the area of the box; and the price of a block's memory, as such a product.
    """

    min_split_size: int
    plain_size: int
    max_leaf_size: int
    sah_depth: int
    costs: tuple[np.float32, np.float32, np.float32]


@device
def put_node(boxes, links, node, box, begin, end):
    """Write a leaf of the references from begin to end."""
    at = boxes + np.uint64(node) * np.uint64(REF_BYTES)
    store(at, box)
    store(at + np.uint64(FIRST_AT), np.int32(begin))
    store(at + np.uint64(COUNT_AT), np.int32(end - begin))
    link = Link(links, np.uint64(node))
    link.left, link.is_top = np.int32(-1), np.int32(0)


@device
def choose_bin_count(count):
    """Bins for a range of references: fewer for a small one."""
    return min(np.int32(BIN_COUNT), np.int32(4) + (np.int32(count) >> np.int32(2)))


@device
def side_test(centroids, bin_count, axis, position):
    """The constants of `is_left` for a split: start and scale of the bins, and bounds."""
    start, scale = bin_frame(centroids, bin_count)
    on_axis = lanes_from_bits(mask4, np.uint64(1) << np.uint64(axis))
    return start, scale, select(on_axis, f32x4(np.float32(position)), f32x4(-INF_F32))


@device
def is_left(ref, test, axis):
    """1 if a reference's centroid is in a bin below the split's position, else 0; uint64.

    From a bit of a mask: compilers turn a scalar comparison into a branch, which is mispredicted
    half of the time.
    """
    start, scale, bound = test
    below = ((high_half(ref) - low_half(ref) - start) * scale) < bound
    return mask_bits(below) >> np.uint64(axis)


class Sides(NamedTuple):
    """Bounds of the references of both sides of a split, and of their centroids: f32x8 each."""

    left: object
    left_centroids: object
    right: object
    right_centroids: object


@device
def no_sides():
    """Sides without references."""
    return Sides(empty_box(), empty_box(), empty_box(), empty_box())


@device
def add_to_side(sides, ref, goes_left):
    """The sides with another reference, on the left one if `goes_left` is 1."""
    on_left, nothing = lanes_from_bits(mask8, np.uint64(0) - goes_left), empty_box()
    centroid = centroid_bounds(ref)
    return Sides(
        maximum(sides.left, select(on_left, ref, nothing)),
        maximum(sides.left_centroids, select(on_left, centroid, nothing)),
        maximum(sides.right, select(on_left, nothing, ref)),
        maximum(sides.right_centroids, select(on_left, nothing, centroid)),
    )


@device
def store_sides(to, sides):
    """Write the boxes of both sides to an address, as an array of shape (2, 2, 8)."""
    store(to, sides.left)
    store(to + np.uint64(REF_BYTES), sides.left_centroids)
    store(to + np.uint64(2 * REF_BYTES), sides.right)
    store(to + np.uint64(3 * REF_BYTES), sides.right_centroids)


@device
def partition(refs, begin, end, centroids, bin_count, axis, position):
    """Move the references of bins below `position` to the front.

    Returns
    -------
    middle : int32
        End of the left part.
    Sides
    """
    test, sides = side_test(centroids, bin_count, axis, position), no_sides()
    at = refs + np.uint64(begin) * np.uint64(REF_BYTES)
    last = refs + np.uint64(end) * np.uint64(REF_BYTES)
    border = at
    # Swap each reference with the first of the right side; the border advances past left ones.
    while at != last:
        ref = load(f32x8, at)
        goes_left = is_left(ref, test, axis)
        sides = add_to_side(sides, ref, goes_left)
        store(at, load(f32x8, border))
        store(border, ref)
        border += goes_left * np.uint64(REF_BYTES)
        at += np.uint64(REF_BYTES)
    return np.int32((border - refs) >> np.uint64(5)), sides


@device
def halve(refs, begin, end):
    """Split a range by count; returns the same as `partition`."""
    middle = np.int32(begin + ((end - begin) >> 1))
    return middle, Sides(*bounds_of(refs, begin, middle), *bounds_of(refs, middle, end))


@device
def bounds_of(refs, begin, end):
    """Bounds of references, and of their centroids."""
    box, centroids = empty_box(), empty_box()
    at = refs + np.uint64(begin) * np.uint64(REF_BYTES)
    last = refs + np.uint64(end) * np.uint64(REF_BYTES)
    while at != last:
        ref = load(f32x8, at)
        box = maximum(box, ref)
        centroids = maximum(centroids, centroid_bounds(ref))
        at += np.uint64(REF_BYTES)
    return box, centroids


@device
def longest_axis(centroids):
    """The axis along which centroids differ most, -1 if all are equal."""
    _, scale = bin_frame(centroids, 2)
    axis, least = np.int32(-1), INF_F32
    for k in range(np.int32(3)):
        if np.float32(0.0) < lane(scale, k) < least:
            axis, least = k, lane(scale, k)
    return axis


@device
def split(refs, begin, end, centroids, use_sides, plain_size, bins, sums):
    """Split a range in two; returns the same as `partition`.

    Parameters
    ----------
    refs : uint64
        Address of all references.
    begin, end : int32
        The range: at least two references.
    centroids : f32x8
        Bounds of their centroids.
    use_sides : bool
        Else the range is halved by count, as it is if all centroids are equal.
    plain_size : int
        Ranges of at most this many are split in the middle of their longest axis, others by the
        surface area heuristic.
    bins, sums : uint64
        Addresses of BINS_BYTES and SUMS_BYTES of scratch.
    """
    axis, position, bin_count = np.int32(-1), np.int32(1), np.int32(2)
    if use_sides:
        if end - begin <= plain_size:
            axis = longest_axis(centroids)
        else:
            bin_count = choose_bin_count(end - begin)
            start, scale = bin_frame(centroids, bin_count)
            clear_bins(bins, bin_count)
            first = refs + np.uint64(begin) * np.uint64(REF_BYTES)
            last = refs + np.uint64(end) * np.uint64(REF_BYTES)
            bin_refs(first, last, start, scale, bins)
            axis, position = find_split(bins, bin_count, sums)
    if axis < np.int32(0):
        return halve(refs, begin, end)
    return partition(refs, begin, end, centroids, bin_count, axis, position)


@device
def push_pending(stack, top, centroids, node, begin, end, depth):
    """Push a range on the stack; returns its height."""
    pending = Pending(stack, top)
    pending.centroids, pending.node = centroids, np.int32(node)
    pending.begin, pending.end = np.int32(begin), np.int32(end)
    pending.depth = np.int32(depth)
    return top + np.uint64(1)
