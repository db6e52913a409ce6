"""Pruning: undoing splits that did not pay.

The kd-tree's builder makes a few splits in a row that cost more than they save, in case later
ones pay. Where they did not, their cells are merged into one sector: bottom up, each subtree is
compared with the leaf that would replace it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, load, scratch, store
from raystream.structures.boxes import face_area, half_area
from raystream.structures.clip import BOX_BYTES, WORD
from raystream.structures.graph.cells import NODE_BYTES, split_of
from raystream.structures.kdtree.layout import LEAF_AXIS, KdArrays
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.subtree import put_leaf

#: Subtrees of more leaves, or of more triangles, are kept.
_MOST_LEAVES, _MOST_TRIANGLES = 16, 64
PENDING_BYTES, UNION_BYTES = 8 * (_MOST_LEAVES + 2), 4 * _MOST_TRIANGLES

_ENTRY = np.uint64(8)
_BLOCK_IDS = np.uint64(16)
_LEAF = np.uint64(LEAF_AXIS)
_LEAF_LIMIT = np.uint64(_MOST_LEAVES)


class Chosen(NamedTuple):
    """The decision for each node of a tree: addresses of a number per node.

    Attributes
    ----------
    leaf_counts : uint64
        Leaves of its subtree, uint32: 1 for a leaf.
    lists : uint64
        Addresses of the triangles of leaves, uint64; for splits, of their first leaf.
    sizes : uint64
        Their number, uint32.
    costs : uint64
        float64.
    """

    leaf_counts: np.uint64
    lists: np.uint64
    sizes: np.uint64
    costs: np.uint64


@device
def _unite(node, nodes, leaf_counts, lists, sizes, pending, union, most):
    """Union of the lists of a subtree's leaves; returns its size, or more than `most`."""
    count = ZERO_U64
    store(pending, node)
    top = pending + _ENTRY
    while top != pending:
        top -= _ENTRY
        inner = load(np.uint64, top)
        if load(np.uint32, leaf_counts + inner * WORD) > np.uint32(1):
            _, first, _ = split_of(nodes, inner)
            store(top, first + ONE_U64)
            store(top + _ENTRY, first)
            top += _ENTRY + _ENTRY
            continue
        at = load(np.uint64, lists + inner * _ENTRY)
        for k in range(np.uint64(load(np.uint32, sizes + inner * WORD))):
            prim_id, place = load(np.int32, at + k * WORD), ZERO_U64
            while place < count and load(np.int32, union + place * WORD) != prim_id:
                place += ONE_U64
            if place < count:
                continue
            if count == most:
                return most + ONE_U64
            store(union + count * WORD, prim_id)
            count += ONE_U64
    return count


@device
def weigh_split(node, nodes, boxes, costs, chosen, free, pending, union):
    """Turn a split into a leaf if that costs no more; its children have been weighed.

    Parameters
    ----------
    node : uint64
    nodes, boxes : uint64
        Addresses of the tree, and of its cells' boxes.
    costs : Costs
    chosen : Chosen
    free : uint64
        Most triangles that its list may have.
    pending, union : uint64
        Addresses of `PENDING_BYTES` and `UNION_BYTES` of scratch.

    Returns
    -------
    uint64
        Length of the list if it pays, whether written or too long; 0 if it does not.

    Notes
    -----
    The lists of a subtree's leaves are consecutive in memory: their union is written over
    them. That holds in the subtrees that the CPU gives to its threads; cells above those
    have more triangles than a new list may have.
    """
    axis, first, _ = split_of(nodes, node)
    box = boxes + node * BOX_BYTES
    half = half_area(box)
    cost = _cost(chosen, first) + _cost(chosen, first + ONE_U64) + costs.traversal * half
    cost += costs.crossing * face_area(box, axis)
    count = np.uint64(load(np.uint32, chosen.leaf_counts + first * WORD))
    count += np.uint64(load(np.uint32, chosen.leaf_counts + (first + ONE_U64) * WORD))
    at = load(np.uint64, chosen.lists + first * _ENTRY)
    store(chosen.lists + node * _ENTRY, at)
    store(chosen.leaf_counts + node * WORD, np.uint32(count))
    store(chosen.costs + node * _ENTRY, cost)
    affordable = cost / (costs.intersection * half)
    most = np.uint64(min(affordable, np.float64(_MOST_TRIANGLES)))
    if count > _LEAF_LIMIT:
        return ZERO_U64
    size = _unite(node, nodes, chosen.leaf_counts, chosen.lists, chosen.sizes, pending, union, most)
    if size > most:
        return ZERO_U64
    if size > free:
        return size
    for k in range(size):
        store(at + k * WORD, load(np.int32, union + k * WORD))
    choose_leaf(node, boxes, costs, chosen, at, size)
    return size


@device
def choose_leaf(node, boxes, costs, chosen, at, size):
    """Make a node a leaf, with the list at an address."""
    cost = costs.intersection * np.float64(size) * half_area(boxes + node * BOX_BYTES)
    store(chosen.lists + node * _ENTRY, at)
    store(chosen.sizes + node * WORD, np.uint32(size))
    store(chosen.leaf_counts + node * WORD, np.uint32(1))
    store(chosen.costs + node * _ENTRY, cost)


@device
def _cost(chosen, node):
    return load(np.float64, chosen.costs + node * _ENTRY)


@kernel
def _choose_leaves(nodes, prim_ids, boxes, costs, leaf_counts, lists, sizes, node_costs):
    """Decide which nodes are leaves.

    Parameters
    ----------
    nodes, prim_ids : ndarray
        See `KdArrays`. Lists of new leaves overwrite those of the leaves they replace.
    boxes : ndarray of shape (M, 6), float32
    costs : Costs
    leaf_counts, lists, sizes, node_costs : ndarray
        Written: see `Chosen`.

    Notes
    -----
    All new lists together have no more rows than `prim_ids`; from the first that does not fit,
    the tree is kept as it is.
    """
    node_at, id_at, box_at = address(nodes), address(prim_ids), address(boxes)
    chosen = Chosen(address(leaf_counts), address(lists), address(sizes), address(node_costs))
    pending, union = scratch(PENDING_BYTES), scratch(UNION_BYTES)
    free = np.uint64(prim_ids.size)
    node = np.uint64(len(nodes))
    while node != ZERO_U64:
        node -= ONE_U64
        axis, count, _ = split_of(node_at, node)
        if axis == _LEAF:
            block = np.uint64(load(np.uint32, node_at + node * NODE_BYTES))
            choose_leaf(node, box_at, costs, chosen, id_at + block * _BLOCK_IDS, count)
        else:
            size = weigh_split(node, node_at, box_at, costs, chosen, free, pending, union)
            free = free - size if size <= free else ZERO_U64


@kernel
def _rebuild(nodes, leaf_counts, lists, sizes, rows, new_nodes, new_ids):
    """Write the pruned tree; `rows` is scratch memory, a number per node."""
    node_at = address(nodes)
    new_at, id_at = address(new_nodes), address(new_ids)
    end, block = ONE_U64, ZERO_U64
    rows[0] = 1  # a row plus 1; 0 for removed nodes
    for node in range(np.uint64(len(nodes))):
        if rows[node] == 0:
            continue
        to = new_at + (np.uint64(rows[node]) - ONE_U64) * NODE_BYTES
        axis, first, plane = split_of(node_at, node)
        if leaf_counts[node] > 1:
            rows[first], rows[first + ONE_U64] = end + ONE_U64, end + TWO_U64
            store(to, plane)
            store(to + WORD, np.int32(end << TWO_U64 | axis))
            end += TWO_U64
            continue
        size = np.uint64(sizes[node])
        block = put_leaf(to, np.uint64(lists[node]), ZERO_U64, size, id_at, block)
    return end, block


def prune(tree: KdArrays, boxes: NDArray[np.float32], costs: Costs) -> KdArrays:
    """Replace subtrees that cost at least as much as a leaf by leaves.

    Parameters
    ----------
    tree : KdArrays
        At least one node.
    boxes : ndarray of shape (M, 6), float32
        Of its cells.
    costs : Costs
        Those that it was built with.

    Returns
    -------
    KdArrays
    """
    count = len(tree.nodes)
    leaf_counts, sizes = np.empty(count, np.uint32), np.empty(count, np.uint32)
    lists = np.empty(count, np.uint64)
    node_costs, list_ids = np.empty(count), tree.prim_ids.copy()
    _choose_leaves(tree.nodes, list_ids, boxes, costs, leaf_counts, lists, sizes, node_costs)
    nodes = np.empty((2 * int(leaf_counts[0]) - 1, 2), np.int32)
    rows = np.zeros(count, np.uint32)
    prim_ids = np.empty((len(tree.prim_ids), 4), np.int32)
    _, block_count = _rebuild(tree.nodes, leaf_counts, lists, sizes, rows, nodes, prim_ids)
    return KdArrays(nodes, prim_ids[: int(block_count)].copy())
