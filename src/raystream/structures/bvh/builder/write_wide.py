"""Write the nodes and leaves of the wide tree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import address, f32x8, i32x8, load, prefetch, scratch, store
from raystream.jit.views import view
from raystream.kernels.leaf_block import (
    BLOCK,
    BLOCK_SIZE,
    TRIANGLE_BYTES,
    clear_block,
    write_triangle,
)
from raystream.structures.bvh.builder.binary_tree import MAX_TREE_DEPTH, Link
from raystream.structures.bvh.builder.collapse import LISTING_BYTES, is_leaf, list_children
from raystream.structures.bvh.builder.prim_refs import COUNT_AT, FIRST_AT, REF_BYTES
from raystream.structures.bvh.layout import CHILDREN_AT, NODE_BYTES, WIDTH

#: A wide node to be written: its binary node, row and depth.
_PENDING = np.dtype([("node", "i4"), ("row", "i4"), ("depth", "i4")])
_Pending = view(_PENDING)
_PENDING_STACK_BYTES = (WIDTH * MAX_TREE_DEPTH + 1) * _PENDING.itemsize

_CHILDREN_BYTES = 4 * WIDTH


#: Distance in references at which corners are prefetched.
READ_AHEAD = 8


class WideTrees(NamedTuple):
    """K wide trees to be written, one for each of some binary nodes.

    Attributes
    ----------
    roots : ndarray of shape (K,), int32
        The binary nodes.
    depths : ndarray of shape (K,), int32
        Wide nodes above each one.
    first_nodes, first_blocks : ndarray of shape (K,), int64
        Where each one's nodes and leaf blocks go.
    counts : ndarray of shape (K, 4), int64
        Nodes, blocks, depth of the deepest node, and deferred children.
    """

    roots: NDArray[np.int32]
    depths: NDArray[np.int32]
    first_nodes: NDArray[np.int64]
    first_blocks: NDArray[np.int64]
    counts: NDArray[np.int64]

    @classmethod
    def of(cls, roots: NDArray[np.int32], depths: NDArray[np.int32]) -> WideTrees:
        """Trees with zeroed counts."""
        count = len(roots)
        firsts = np.zeros(count, np.int64), np.zeros(count, np.int64)
        return cls(roots, depths, *firsts, np.zeros((count, 4), np.int64))


class Deferred(NamedTuple):
    """Children below the top of the tree, which are not written with it.

    Attributes
    ----------
    nodes : ndarray of shape (D,), int32
        Binary nodes; D is 0 to defer none.
    rows : ndarray of shape (D,), int64
        Rows of their wide nodes.
    depths : ndarray of shape (D,), int32
        Wide nodes above each one.
    """

    nodes: NDArray[np.int32]
    rows: NDArray[np.int64]
    depths: NDArray[np.int32]

    @classmethod
    def of(cls, room: int) -> Deferred:
        """Room for a number of children."""
        return cls(np.empty(room, np.int32), np.zeros(room, np.int64), np.empty(room, np.int32))


@device
def clear_node(node):
    """Write a node without children."""
    for axis in range(np.uint64(3)):
        store(node + axis * np.uint64(64), f32x8(INF_F32))
        store(node + axis * np.uint64(64) + np.uint64(32), f32x8(-INF_F32))
    store(node + np.uint64(CHILDREN_AT), i32x8(np.int32(0)))
    store(node + np.uint64(CHILDREN_AT + 32), i32x8(np.int32(0)))


@device
def set_lane(node, lane, box, child):
    """Write a child of a node: its box, at an address, and its link."""
    at = node + lane * np.uint64(4)
    for axis in range(np.uint64(3)):
        plane = box + axis * np.uint64(4)
        store(at + axis * np.uint64(64), -load(np.float32, plane))
        store(at + axis * np.uint64(64) + np.uint64(32), load(np.float32, plane + np.uint64(16)))
    store(at + np.uint64(CHILDREN_AT), np.int32(child))


@device_call
def _write_leaf(ref, count, corners, to):
    """Write the blocks of a leaf to address `to`."""
    for i in range(np.uint64(count)):
        lane = i & np.uint64(BLOCK_SIZE - 1)
        block = to + (i >> np.uint64(2)) * BLOCK
        if lane == np.uint64(0) and np.uint64(count) - i < np.uint64(BLOCK_SIZE):
            clear_block(block)
        id_at = ref + i * np.uint64(REF_BYTES) + np.uint64(FIRST_AT)
        prim_id = load(np.int32, id_at)
        # Corners are far apart: prefetch those of a later reference, often of another leaf.
        later = load(np.int32, id_at + np.uint64(READ_AHEAD * REF_BYTES))
        later_corner = corners + np.uint64(later) * TRIANGLE_BYTES
        prefetch(later_corner)
        prefetch(later_corner + (TRIANGLE_BYTES - np.uint64(4)))
        write_triangle(block, lane, prim_id, corners)


@kernel
def write_trees(begin, end, trees, deferred, write, tree, corners, wide):
    """Count or write the wide trees below some binary nodes.

    Parameters
    ----------
    begin, end : int
        Which of `trees`.
    trees : WideTrees
        Counts are written, or the trees from `first_nodes` and `first_blocks` on.
    deferred : Deferred
        Written when counting, read when writing.
    write : bool
        Else only count.
    tree : BinaryTree
    corners : ndarray of shape (F, 3, 3), float32
        Of all triangles.
    wide : BvhArrays
        Written.
    """
    ref_at, corner_at = address(tree.refs), address(corners)
    box_at, link_at = address(tree.boxes), address(tree.links)
    node_at, leaf_at = address(wide.nodes), address(wide.leaves)
    stack = scratch(_PENDING_STACK_BYTES)
    listing = scratch(LISTING_BYTES)
    children = scratch(_CHILDREN_BYTES)
    defers = len(deferred.nodes) != 0
    for task in range(np.uint64(begin), np.uint64(end)):
        node_end = np.int32(trees.first_nodes[task])
        block_end = np.int32(trees.first_blocks[task])
        first_node, first_block = node_end, block_end
        deepest = np.int32(0)
        deferred_count = np.uint64(0)
        root = np.int32(trees.roots[task])
        pending = _Pending(stack)
        pending.node, pending.row, pending.depth = root, node_end, np.int32(trees.depths[task])
        node_end = np.int32(node_end + 1)
        top = np.uint64(1)
        while top != np.uint64(0):
            top -= np.uint64(1)
            pending = _Pending(stack, top)
            parent = pending.node
            to = node_at + np.uint64(pending.row) * np.uint64(NODE_BYTES)
            depth = np.int32(pending.depth + np.int32(1))
            deepest = max(deepest, depth)
            if write:
                clear_node(to)
            if parent == root and is_leaf(link_at, parent):
                store(children, parent)  # the whole tree is one leaf
                lane_count = np.uint64(1)
            else:
                lane_count = list_children(link_at, parent, listing, children)
            # The last is pushed first, so that subtrees are written in the order of lanes.
            # Rows go up with the lanes.
            inner_count = np.int32(0)
            for k in range(lane_count):
                child = load(np.int32, children + k * np.uint64(4))
                is_top = Link(link_at, np.uint64(child)).is_top != np.int32(0)
                box = box_at + np.uint64(child) * np.uint64(REF_BYTES)
                if is_leaf(link_at, child):
                    first = np.uint64(load(np.int32, box + np.uint64(FIRST_AT)))
                    count = load(np.int32, box + np.uint64(COUNT_AT))
                    blocks = np.int32((count + np.int32(BLOCK_SIZE - 1)) >> np.int32(2))
                    if write:
                        set_lane(to, k, box, ~((block_end << np.int32(3)) | (blocks - np.int32(1))))
                        ref = ref_at + first * np.uint64(REF_BYTES)
                        to_leaf = leaf_at + np.uint64(block_end) * BLOCK
                        _write_leaf(ref, count, corner_at, to_leaf)
                    block_end = np.int32(block_end + blocks)
                elif defers and not is_top:
                    if write:
                        set_lane(to, k, box, deferred.rows[deferred_count])
                    else:
                        deferred.nodes[deferred_count] = child
                        deferred.depths[deferred_count] = depth
                    deferred_count += np.uint64(1)
                else:
                    if write:
                        set_lane(to, k, box, node_end + inner_count)
                    inner_count = np.int32(inner_count + 1)
                    store(children + np.uint64(inner_count - 1) * np.uint64(4), child)
            top += np.uint64(inner_count)
            for k in range(np.uint64(inner_count)):
                pending = _Pending(stack, top - (k + np.uint64(1)))
                pending.node = load(np.int32, children + k * np.uint64(4))
                pending.row, pending.depth = np.int32(node_end + np.int32(k)), depth
            node_end = np.int32(node_end + inner_count)
        if not write:
            counts = trees.counts[task]
            counts[0], counts[1] = node_end - first_node, block_end - first_block
            counts[2], counts[3] = deepest, deferred_count
