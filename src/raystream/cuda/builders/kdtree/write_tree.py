"""Final layout of a kd-tree grown on a device: the CPU's order, as traversals read it."""

from __future__ import annotations

import numpy as np

from raystream.cuda.builders.kdtree.blocks import copy_list, empty_lists, filled_blocks
from raystream.cuda.builders.kdtree.grow import GrownTree
from raystream.cuda.builders.kdtree.numbering import Numbers, split_at
from raystream.jit.constants import ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.simd import load, store
from raystream.structures.clip import HIGH, WORD
from raystream.structures.kdtree.layout import LEAF_AXIS

_NODE = np.uint64(8)
_RECORD = np.uint64(32)
_OWN_AT = np.uint64(24)
_LEAF = np.uint64(LEAF_AXIS)


@gpu_kernel(numbering=Numbers)
def write_tree_node(node, nodes, tree_ids, numbering, to_nodes, prim_ids):
    """Write a node to its row, and a leaf's triangles to its blocks."""
    axis, number = split_at(nodes, node)
    first = load(np.uint32, nodes + node * _NODE)
    to = to_nodes + np.uint64(load(np.uint32, numbering.rows + node * WORD)) * _NODE
    if axis != _LEAF:
        row = np.uint64(load(np.uint32, numbering.firsts + node * WORD))
        store(to, first)
        store(to + WORD, np.uint32(row << TWO_U64 | axis))
        return
    place = np.uint64(load(np.uint32, numbering.places + node * WORD))
    store(to, np.uint32(place >> TWO_U64))
    store(to + WORD, np.uint32(number << TWO_U64 | axis))
    copy_list(tree_ids + np.uint64(first) * WORD, number, prim_ids + place * WORD)


@gpu_kernel(numbering=Numbers)
def extend_children(i, first, nodes, numbering, extended):
    """Write the bounds of the children of node first + i that are splits, given its own."""
    node = first + i
    axis, child = split_at(nodes, node)
    if axis == _LEAF:
        return
    row = np.uint64(load(np.uint32, numbering.firsts + node * WORD))
    own, plane = extended + (row >> ONE_U64) * _RECORD, load(np.float32, nodes + node * _NODE)
    for side in range(TWO_U64):
        child_axis, _ = split_at(nodes, child + side)
        if child_axis == _LEAF:
            continue
        child_row = np.uint64(load(np.uint32, numbering.firsts + (child + side) * WORD))
        to = extended + (child_row >> ONE_U64) * _RECORD
        for k in range(np.uint64(6)):
            store(to + k * WORD, load(np.float32, own + k * WORD))
        at = to + axis * WORD
        if side == ZERO_U64:  # below the plane
            store(at + HIGH, min(load(np.float32, at + HIGH), plane))
        else:
            store(at, max(load(np.float32, at), plane))
        store(to + _OWN_AT, np.uint32(row + side))
        store(to + _OWN_AT + WORD, np.uint32(0))


def write_tree(
    gpu: Gpu, tree: GrownTree, numbers: Numbers, corners: DeviceArray, is_extended: bool
) -> tuple[DeviceArray, ...]:
    """Launch the kernels that write a tree.

    Parameters
    ----------
    gpu : Gpu
    tree : GrownTree
    numbers : Numbers
        Of this tree.
    corners : DeviceArray of shape (F, 3, 3), float32
        The triangles' corners.
    is_extended : bool
        Whether to write the bounds that backtracking reads.

    Returns
    -------
    nodes : DeviceArray of shape (M, 2), int32
        See `kdtree.layout.KdArrays`.
    blocks : DeviceArray of shape (B, 40), float32
        The leaves' triangles; see `kernels.leaf_block`.
    extended : DeviceArray of shape (S, 8), float32
        If there are bounds; see `kdtree.foley_layout.extend`.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    count = len(tree.nodes)
    block_count = int(numbers.rooms.part(0, 1).host()[0]) // 4
    nodes = gpu.empty("nodes", (count, 2), np.int32)
    prim_ids = empty_lists(gpu, block_count)
    write_tree_node.launch(gpu, count, (tree.nodes, tree.ids, numbers, nodes, prim_ids))
    extended = [_extended(gpu, tree, numbers)] if is_extended else []
    return nodes, filled_blocks(gpu, prim_ids, corners), *extended


def _extended(gpu: Gpu, tree: GrownTree, numbers: Numbers) -> DeviceArray:
    """Launch the kernels that write the bounds of splits for backtracking."""
    extended = gpu.empty("bounds of splits", (len(tree.nodes) // 2, 8), np.float32)
    if len(extended):
        root = np.array([-np.inf] * 3 + [np.inf] * 3 + [0.0] * 2, np.float32)
        # The root is in row 0, which the compact layout stores in place of a parent.
        extended.part(0, 8).fill(root)
    tree.launch_by_level(gpu, (extend_children, (tree.nodes, numbers, extended)))
    return extended
