"""Sectors of a graph from the leaves of a tree: their ropes, order and rows."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.graph.pruning import Lists
from raystream.cuda.builders.kdtree.blocks import copy_list
from raystream.cuda.builders.kdtree.grow import GrownTree
from raystream.cuda.builders.kdtree.numbering import Numbers, split_at
from raystream.jit.constants import BYTES_64, ONE_U64, THREE_U64, ZERO_U64
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.radix_sort import sort_pairs
from raystream.jit.cuda.scan import scan, scan_in_place
from raystream.jit.simd import load, store
from raystream.structures.clip import BOX_BYTES, WORD
from raystream.structures.graph.bins import leaf_at
from raystream.structures.graph.cells import is_leaf, write_children
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.morton_order import (
    CODE_BITS,
    SECTOR_BYTES,
    fill_sector,
    morton_code,
)

_LANES = np.uint64(4)
_BLOCK_IDS = np.uint64(16)
_ROWS = np.uint64(SECTOR_ROWS)


class Ordered(NamedTuple):
    """The mapping between sectors and leaves of a tree, on a device.

    Attributes
    ----------
    leaves : DeviceArray of shape (S,), uint32
        The node of each sector.
    sectors : DeviceArray of shape (M,), uint32
        The sector of each node that is a leaf.
    ropes : DeviceArray of shape (M, 6), int32
        See `structures.graph.cells.Cells`.
    rows : DeviceArray of shape (M,), uint32
        The CPU's row of each node of the pruned tree.
    by_row : DeviceArray of shape (2 S - 1,), uint32
        The node in each of these rows.
    """

    leaves: DeviceArray
    sectors: DeviceArray
    ropes: DeviceArray
    rows: DeviceArray
    by_row: DeviceArray


@gpu_kernel()
def place_cells(i, first, nodes, is_in, old_rows, boxes, ropes, marks):
    """Write the cells of the children of node first + i, if it is a remaining split."""
    node = first + i
    if load(np.uint8, is_in + node) == np.uint8(0) or is_leaf(nodes, node):
        return
    write_children(nodes, node, boxes, ropes)
    _, child = split_at(nodes, node)
    store(is_in + child, np.uint8(1))
    store(is_in + child + ONE_U64, np.uint8(1))
    store(marks + np.uint64(load(np.uint32, old_rows + node * WORD)) * WORD, np.uint32(1))


@gpu_kernel()
def place_nodes(node, nodes, is_in, old_rows, ranks, rows, by_row):
    """Write the rows of a split's children, which are in the order of their parents."""
    if node == ZERO_U64:
        store(rows, np.uint32(0))
        store(by_row, np.uint32(0))
    if load(np.uint8, is_in + node) == np.uint8(0) or is_leaf(nodes, node):
        return
    old_row = np.uint64(load(np.uint32, old_rows + node * WORD))
    rank = np.uint64(load(np.uint32, ranks + old_row * WORD))
    _, child = split_at(nodes, node)
    for side in range(np.uint64(2)):
        row = (rank << ONE_U64) + ONE_U64 + side
        store(rows + (child + side) * WORD, np.uint32(row))
        store(by_row + row * WORD, np.uint32(child + side))


@gpu_kernel()
def mark_leaf(row, nodes, by_row, marks):
    """Mark a row whose node is a leaf."""
    found = is_leaf(nodes, np.uint64(load(np.uint32, by_row + row * WORD)))
    store(marks + row * WORD, np.uint32(ONE_U64 if found else ZERO_U64))


@gpu_kernel()
def list_leaf(row, nodes, boxes, by_row, before, codes, leaves):
    """List the leaf in a row with its Morton code."""
    node = np.uint64(load(np.uint32, by_row + row * WORD))
    if is_leaf(nodes, node):
        to = np.uint64(load(np.uint32, before + row * WORD))
        store(codes + to * BYTES_64, np.uint64(morton_code(boxes, boxes + node * BOX_BYTES)))
        store(leaves + to * WORD, np.uint32(node))


@gpu_kernel()
def number_sector(sector, leaves, sizes, sectors, block_counts):
    """Write a leaf's sector, and count its blocks."""
    leaf = np.uint64(load(np.uint32, leaves + sector * WORD))
    store(sectors + leaf * WORD, np.uint32(sector))
    count = np.uint64(load(np.uint32, sizes + leaf * WORD))
    store(block_counts + sector * WORD, np.uint32((count + THREE_U64) // _LANES))


@gpu_kernel()
def write_sector(sector, leaves, boxes, lists, sizes, firsts, rows, prim_ids):
    """Write a sector's row, except for its links, and its triangle list."""
    leaf = np.uint64(load(np.uint32, leaves + sector * WORD))
    count = np.uint64(load(np.uint32, sizes + leaf * WORD))
    first = np.uint64(load(np.uint32, firsts + sector * WORD))
    fill_sector(rows + sector * SECTOR_BYTES, boxes + leaf * BOX_BYTES, first, count)
    source = load(np.uint64, lists + leaf * BYTES_64)
    copy_list(source, count, prim_ids + first * _BLOCK_IDS)


@gpu_kernel()
def fill_bin(row, nodes, sectors, x, y, z, y_count, z_count, bins):
    """Find the sector at a bin's low corner; z varies fastest."""
    yz = row // z_count
    px = load(np.float32, x + yz // y_count * WORD)
    py = load(np.float32, y + yz % y_count * WORD)
    leaf = leaf_at(nodes, px, py, load(np.float32, z + row % z_count * WORD))
    sector = np.uint64(load(np.uint32, sectors + leaf * WORD))
    store(bins + row * WORD, np.uint32(sector * _ROWS))


def order_sectors(gpu: Gpu, tree: GrownTree, numbers: Numbers) -> Ordered:
    """Find the leaves of a pruned tree, their ropes and their Morton order.

    Parameters
    ----------
    gpu : Gpu
    tree : GrownTree
        Pruned.
    numbers : Numbers
        Of the unpruned tree.

    Returns
    -------
    Ordered
        Sectors are in the CPU's order.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    count, nodes, boxes = len(tree.nodes), tree.nodes, tree.boxes
    is_in = gpu.zeros("nodes that are left", count, np.uint8)
    marks = gpu.zeros("marks", count + 1, np.uint32)
    is_in.part(0, 1).fill(np.ones(1, np.uint8))
    ropes = gpu.empty("ropes", (count, 6), np.int32)
    ropes.part(0, 6).fill(np.full(6, -1, np.int32))
    old = nodes, is_in, numbers.rows
    tree.launch_by_level(gpu, (place_cells, (*old, boxes, ropes, marks)))
    sector_count = scan_in_place(gpu, marks) + 1
    node_count = 2 * sector_count - 1
    rows = gpu.empty("rows of nodes", count, np.uint32)
    by_row = gpu.empty("nodes by row", node_count, np.uint32)
    place_nodes.launch(gpu, count, (*old, marks, rows, by_row))
    before = gpu.empty("leaves before rows", node_count + 1, np.uint32)
    mark_leaf.launch(gpu, node_count, (nodes, by_row, before))
    scan(gpu, before)
    codes = gpu.empty("codes", sector_count, np.uint64)
    leaves = gpu.empty("leaves", sector_count, np.uint32)
    list_leaf.launch(gpu, node_count, (nodes, boxes, by_row, before, codes, leaves))
    _, leaves = sort_pairs(gpu, codes, leaves, CODE_BITS)
    return Ordered(leaves, gpu.empty("sectors", count, np.uint32), ropes, rows, by_row)


def number_sectors(gpu: Gpu, ordered: Ordered, lists: Lists) -> tuple[DeviceArray, int]:
    """Write the sector of each leaf.

    Returns
    -------
    firsts : DeviceArray of shape (S + 1,), uint32
        The first block of each sector.
    block_count : int
        Of all sectors.

    Raises
    ------
    CudaError
        If device memory runs out.
    """
    count = len(ordered.leaves)
    firsts = gpu.empty("first blocks", count + 1, np.uint32)
    number_sector.launch(gpu, count, (ordered.leaves, lists.sizes, ordered.sectors, firsts))
    return firsts, scan_in_place(gpu, firsts)
