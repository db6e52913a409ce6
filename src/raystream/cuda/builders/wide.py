"""Collapse of a binary tree on the device to the wide tree that rays traverse, level by level.

Which binary nodes become wide ones was decided when they were written
(`structures.bvh.builder.collapse`).
Here the wide nodes get rows, level after level, so that children follow their parents and a level
can be refitted in one launch.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.binary_tree import Nodes
from raystream.jit.constants import BITS_32, LOW_32, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.scan import Scan
from raystream.jit.simd import load, scratch, store
from raystream.kernels.leaf_block import BLOCK, BLOCK_FLOATS, clear_block, write_triangle
from raystream.structures.bvh.builder.binary_tree import Link
from raystream.structures.bvh.builder.collapse import LISTING_BYTES, is_leaf, list_children
from raystream.structures.bvh.builder.prim_refs import COUNT_AT, FIRST_AT, REF_BYTES
from raystream.structures.bvh.builder.write_wide import clear_node, set_lane
from raystream.structures.bvh.layout import (
    MAX_BLOCKS,
    MAX_DEPTH,
    NODE_BYTES,
    NODE_FLOATS,
)
from raystream.structures.bvh.options import MAX_LEAF_SIZE

_LANES_BYTES = 32
_WALK_BYTES = 4 * (MAX_LEAF_SIZE + 1)

_IN_BLOCK = np.uint64(3)


class TooDeepError(Exception):
    """A tree has more levels than its traversal supports."""


class WideTree(NamedTuple):
    """`structures.bvh.layout.BvhArrays` in device memory.

    Attributes
    ----------
    nodes : DeviceArray of shape (M, 64), float32
    leaves : DeviceArray of shape (B, 40), float32
    levels : tuple of int
        Level i is rows levels[i] to levels[i + 1].
    """

    nodes: DeviceArray
    leaves: DeviceArray
    levels: tuple[int, ...]


@device
def _block_count(boxes, row):
    """Number of leaf blocks of a binary node that becomes a leaf."""
    count = load(np.int32, boxes + row * np.uint64(REF_BYTES) + np.uint64(COUNT_AT))
    return (np.uint64(count) + _IN_BLOCK) >> np.uint64(2)


@device
def _fill_lanes(nodes, root, is_first, lanes):
    """List the binary nodes in the lanes of a wide one, int32 each; returns their number."""
    if is_first and is_leaf(nodes.links, root):
        store(lanes, root)  # the whole tree is one leaf
        return ONE_U64
    return list_children(nodes.links, root, scratch(LISTING_BYTES), lanes)


@device
def _lane(lanes, k):
    return load(np.int32, lanes + (k << SHIFT_32))


@gpu_kernel(nodes=Nodes)
def count_lanes(i, first, nodes, roots, counts):
    """Count the inner children of wide node first + i (1 each) and its leaf blocks (2**32 each)."""
    row = first + i
    lanes = scratch(_LANES_BYTES)
    root = load(np.int32, roots + (row << SHIFT_32))
    found = ZERO_U64
    for k in range(_fill_lanes(nodes, root, row == ZERO_U64, lanes)):
        child = _lane(lanes, k)
        if is_leaf(nodes.links, child):
            found += _block_count(nodes.boxes, np.uint64(child)) << BITS_32
        else:
            found += ONE_U64
    store(counts + (i << SHIFT_64), found)


@gpu_kernel(nodes=Nodes)
def give_rows(i, first, level_end, first_block, nodes, counts, roots, first_children, blocks):
    """Assign rows to the children of wide node first + i, and write their binary nodes."""
    row = first + i
    lanes = scratch(_LANES_BYTES)
    root = load(np.int32, roots + (row << SHIFT_32))
    before = load(np.uint64, counts + (i << SHIFT_64))
    child_row = level_end + (before & LOW_32)
    store(first_children + (row << SHIFT_32), np.uint32(child_row))
    store(blocks + (row << SHIFT_32), np.uint32(first_block + (before >> BITS_32)))
    for k in range(_fill_lanes(nodes, root, row == ZERO_U64, lanes)):
        child = _lane(lanes, k)
        if not is_leaf(nodes.links, child):
            store(roots + (child_row << SHIFT_32), child)
            child_row += ONE_U64


@device
def _write_triangle(prim_id, place, corners, leaf):
    """Copy a triangle to a slot in the blocks of a leaf."""
    block = leaf + (place >> np.uint64(2)) * BLOCK
    if place & _IN_BLOCK == ZERO_U64:
        clear_block(block)
    write_triangle(block, place & _IN_BLOCK, prim_id, corners)


@device
def _write_leaf(nodes, root, corners, leaf):
    """Write the triangles below a binary node to a leaf, at most `MAX_LEAF_SIZE`."""
    pending = scratch(_WALK_BYTES)
    store(pending, root)
    top, place = pending + np.uint64(4), ZERO_U64
    while top != pending:
        top -= np.uint64(4)
        row = np.uint64(load(np.int32, top))
        link = Link(nodes.links, row)
        left = link.left
        if left < np.int32(0):
            box = nodes.boxes + row * np.uint64(REF_BYTES)
            _write_triangle(load(np.int32, box + np.uint64(FIRST_AT)), place, corners, leaf)
            place += ONE_U64
        else:
            store(top, link.right)
            store(top + np.uint64(4), left)
            top += np.uint64(8)


@gpu_kernel(nodes=Nodes)
def write_node(row, nodes, roots, first_children, blocks, corners, wide, leaves):
    """Write a wide node and its leaves."""
    to = wide + row * np.uint64(NODE_BYTES)
    lanes = scratch(_LANES_BYTES)
    root = load(np.int32, roots + (row << SHIFT_32))
    child_row = load(np.uint32, first_children + (row << SHIFT_32))
    block = load(np.uint32, blocks + (row << SHIFT_32))
    clear_node(to)
    for k in range(_fill_lanes(nodes, root, row == ZERO_U64, lanes)):
        child = _lane(lanes, k)
        box = nodes.boxes + np.uint64(child) * np.uint64(REF_BYTES)
        if is_leaf(nodes.links, child):
            # A leaf's link is its first block, and in three bits the number of blocks less 1.
            own = np.int32(_block_count(nodes.boxes, np.uint64(child)))
            link = ~((np.int32(block) << np.int32(3)) | (own - np.int32(1)))
            set_lane(to, k, box, np.int32(link))
            leaf = leaves + np.uint64(block) * BLOCK
            _write_leaf(nodes, child, corners, leaf)
            block = np.uint32(block + np.uint32(own))
        else:
            set_lane(to, k, box, np.int32(child_row))
            child_row = np.uint32(child_row + np.uint32(1))


def make_wide(gpu: Gpu, nodes: Nodes, root: int, corners: DeviceArray) -> WideTree:
    """Collapse a binary tree to a wide one.

    Parameters
    ----------
    gpu : Gpu
    nodes : Nodes
        A complete tree.
    root : int
        The root's row.
    corners : DeviceArray of shape (F, 3, 3), float32
        The triangles' corners.

    Raises
    ------
    TooDeepError
        If it has more than `MAX_DEPTH` levels.
    ValueError
        If it would be too large for the layout.
    CudaError
        If device memory runs out.

    Notes
    -----
    The host waits for the device once per level, to read the size of the next one.
    """
    room = max(1, nodes.leaf_count - 1)  # each wide node has two children or more
    roots, first_children, blocks = (
        gpu.empty(name, room, np.uint32) for name in ("roots", "first children", "first blocks")
    )
    placed = roots, first_children, blocks
    counts = gpu.empty("children of a level", room + 1, np.uint64)
    scan = Scan(gpu, room)
    roots.part(0, 1).fill(np.array([root], np.uint32))
    levels, block_total = [0, 1], 0
    while levels[-1] != levels[-2]:
        if len(levels) > MAX_DEPTH + 1:
            raise TooDeepError
        first, end = levels[-2:]
        count_lanes.launch(gpu, end - first, (np.uint64(first), nodes, roots, counts))
        scan.run(counts.address, end - first, counts.address, np.uint64)
        begins = np.uint64(first), np.uint64(end), np.uint64(block_total)
        give_rows.launch(gpu, end - first, (*begins, nodes, counts, *placed))
        found = int(counts.part(end - first, 1).host()[0])
        levels.append(end + (found & 0xFFFFFFFF))
        block_total += found >> 32
        if block_total > MAX_BLOCKS:
            raise ValueError(f"{block_total:,} leaf blocks are more than {MAX_BLOCKS:,}")
    levels.pop()
    wide = gpu.empty("nodes", (levels[-1], NODE_FLOATS), np.float32)
    leaves = gpu.empty("leaves", (block_total, BLOCK_FLOATS), np.float32)
    write_node.launch(gpu, levels[-1], (nodes, *placed, corners, wide, leaves))
    return WideTree(wide, leaves, tuple(levels))
