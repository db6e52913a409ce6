"""Numbering of a kd-tree's nodes in the CPU's order, level by level.

The CPU splits large cells level by level, and gives each smaller one to a thread, which numbers its
subtree depth first, the side below a plane first. Structures made from the tree depend on these
numbers. They follow from the number of splits in each subtree.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.kdtree.grow import GrownTree
from raystream.jit.constants import BITS_32, BYTES_64, LOW_32, ONE_U64, THREE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.scan import scan
from raystream.jit.simd import load, store
from raystream.structures.clip import WORD
from raystream.structures.kdtree.build import subtree_size
from raystream.structures.kdtree.layout import LEAF_AXIS

_NODE = np.uint64(8)
_LEAF = np.uint64(LEAF_AXIS)


class Numbers(NamedTuple):
    """The CPU's numbers of nodes: arrays of shape (M,), uint32.

    Attributes
    ----------
    splits : DeviceArray
        Number of splits in its subtree.
    rooms : DeviceArray
        References in its subtree, those of each leaf rounded up to blocks of four.
    firsts : DeviceArray
        The CPU's row of a split's child below the plane.
    rows : DeviceArray
        The CPU's row of the node itself.
    places : DeviceArray
        Rooms of all leaves that the CPU lists before its subtree's; not set for large cells.
    """

    splits: DeviceArray
    rooms: DeviceArray
    firsts: DeviceArray
    rows: DeviceArray
    places: DeviceArray


@device
def split_at(nodes, node):
    """A node's axis, 3 for a leaf, and its first child or the number of its references."""
    word = np.uint64(load(np.uint32, nodes + node * _NODE + WORD))
    return word & THREE_U64, word >> TWO_U64


@device
def _get(numbers, i):
    return np.uint64(load(np.uint32, numbers + i * WORD))


@device
def _put(numbers, i, number):
    store(numbers + i * WORD, np.uint32(number))


@gpu_kernel(numbering=Numbers)
def count_below(i, first, nodes, numbering):
    """Count the splits and references below node first + i; its children are done."""
    node = first + i
    axis, child = split_at(nodes, node)
    splits, room = ZERO_U64, (child + THREE_U64) & ~THREE_U64
    if axis != _LEAF:
        splits = _get(numbering.splits, child) + _get(numbering.splits, child + ONE_U64) + ONE_U64
        room = _get(numbering.rooms, child) + _get(numbering.rooms, child + ONE_U64)
    _put(numbering.splits, node, splits)
    _put(numbering.rooms, node, room)


@device
def _is_large(nodes, node, sizes, most):
    """Whether the CPU splits a cell before it gives subtrees to threads."""
    axis, _ = split_at(nodes, node)
    return axis != _LEAF and _get(sizes, node) > most


@device
def _visit_subtrees(node, nodes, sizes, most, visit, to):
    """Visit the subtrees directly below a large cell, or the root; returns whether it is large."""
    if not _is_large(nodes, node, sizes, most):
        if node == ZERO_U64:
            visit(node, to)
        return False
    _, child = split_at(nodes, node)
    for side in range(TWO_U64):
        if not _is_large(nodes, child + side, sizes, most):
            visit(child + side, to)
    return True


@device
def _note_subtree(node, to):
    """Store the rows and the room of a subtree."""
    numbering, marks, rooms = to
    store(marks + node * BYTES_64, _get(numbering.splits, node) << ONE_U64)
    store(rooms + node * BYTES_64, _get(numbering.rooms, node))


@gpu_kernel(numbering=Numbers)
def mark_large(node, nodes, sizes, most, numbering, marks, rooms):
    """Mark a large cell (2**32), and store rows and room of subtrees directly below it."""
    if _visit_subtrees(node, nodes, sizes, most, _note_subtree, (numbering, marks, rooms)):
        store(marks + node * BYTES_64, ONE_U64 << BITS_32)


@device
def _begin_subtree(node, to):
    """Write where a subtree begins: after large cells and earlier subtrees."""
    marks, rooms, count, numbering = to
    large_count = load(np.uint64, marks + count * BYTES_64) >> BITS_32
    before = load(np.uint64, marks + node * BYTES_64) & LOW_32
    _put(numbering.firsts, node, ONE_U64 + (large_count << ONE_U64) + before)
    _put(numbering.places, node, load(np.uint64, rooms + node * BYTES_64))


@gpu_kernel(numbering=Numbers)
def begin_rows(node, nodes, sizes, most, marks, rooms, count, numbering):
    """Write the first rows of large cells, and where the subtrees below them begin."""
    if node == ZERO_U64:
        _put(numbering.rows, node, ZERO_U64)
    to = marks, rooms, count, numbering
    if _visit_subtrees(node, nodes, sizes, most, _begin_subtree, to):
        before = load(np.uint64, marks + node * BYTES_64) >> BITS_32
        _put(numbering.firsts, node, ONE_U64 + (before << ONE_U64))


@gpu_kernel(numbering=Numbers)
def number_children(i, first, nodes, sizes, most, numbering):
    """Write the rows and places of the children of node first + i, and their first rows."""
    node = first + i
    axis, child = split_at(nodes, node)
    if axis == _LEAF:
        return
    row = _get(numbering.firsts, node)
    _put(numbering.rows, child, row)
    _put(numbering.rows, child + ONE_U64, row + ONE_U64)
    if not _is_large(nodes, node, sizes, most):
        # Depth first: all rows and leaves below the plane come before those above it.
        place = _get(numbering.places, node)
        _put(numbering.places, child, place)
        _put(numbering.places, child + ONE_U64, place + _get(numbering.rooms, child))
        _put(numbering.firsts, child, row + TWO_U64)
        after = _get(numbering.splits, child) << ONE_U64
        _put(numbering.firsts, child + ONE_U64, row + TWO_U64 + after)


def number_nodes(gpu: Gpu, tree: GrownTree, triangle_count: int) -> Numbers:
    """Launch the kernels that number a tree's nodes as the CPU does.

    Parameters
    ----------
    gpu : Gpu
    tree : GrownTree
    triangle_count : int
        Determines which cells the CPU treats as large.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    count = len(tree.nodes)
    numbers = Numbers(*(gpu.empty(name, count, np.uint32) for name in Numbers._fields))
    tree.launch_by_level(gpu, (count_below, (tree.nodes, numbers)), upward=True)
    marks = gpu.zeros("large cells", count + 1, np.uint64)
    rooms = gpu.zeros("rooms of subtrees", count + 1, np.uint64)
    cells = tree.nodes, tree.sizes, np.uint64(subtree_size(triangle_count))
    mark_large.launch(gpu, count, (*cells, numbers, marks, rooms))
    for one in (marks, rooms):
        scan(gpu, one)
    begin_rows.launch(gpu, count, (*cells, marks, rooms, np.uint64(count), numbers))
    tree.launch_by_level(gpu, (number_children, (*cells, numbers)))
    return numbers
