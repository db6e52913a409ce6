"""The subtrees behind the faces of a leaf: raw nodes of its links, and covered subtrees.

See `links`, which does so for all leaves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, THREE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.structures.clip import BOX_BYTES, HIGH, WORD
from raystream.structures.graph.cells import ROPE_BYTES, is_leaf, push_rope, split_of
from raystream.structures.graph.hash_consing import RAW
from raystream.structures.graph.layout import SECTOR_ROWS, VOID
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.options import MAX_DEPTH

#: A pending subtree: its node, and the address of the raw link to it.
_PENDING = np.uint64(16)
PENDING_BYTES = 16 * (MAX_DEPTH + 2)

_SIX = np.uint64(6)
_HALF_ROW = np.uint64(8)
_RAW_BYTES = np.uint64(24)
_RAW_BIT = np.uint64(RAW)
_ROWS = np.uint64(SECTOR_ROWS)
_VOID = np.uint64(VOID)
_LEAF = np.uint64(LEAF_AXIS)
_NOWHERE = np.int32(-1)
_YES = np.uint8(1)


class RopeTree(NamedTuple):
    """A kd-tree with ropes, by address.

    Attributes
    ----------
    nodes : uint64
        See `kdtree.layout.KdArrays`.
    axes : uint64
        Axes of the splits in each subtree, as bits of a byte.
    boxes, ropes : uint64
        See `cells.Cells`.
    """

    nodes: np.uint64
    axes: np.uint64
    boxes: np.uint64
    ropes: np.uint64


@device
def find_axes(nodes, node, axes):
    """Write the axes of the splits in a subtree, as bits, given those of its children."""
    axis, first, _ = split_of(nodes, node)
    found = np.uint8(0)
    if axis != _LEAF:
        found = load(np.uint8, axes + first) | load(np.uint8, axes + first + ONE_U64)
        found |= np.uint8(ONE_U64 << axis)
    store(axes + node, np.uint8(found))


@device
def _covers(box, cell, face, axes):
    """Whether a face of a box covers the adjacent side of a cell along some axes."""
    axis = face >> ONE_U64
    for other in range(THREE_U64):
        at = other * WORD
        is_out = load(np.float32, cell + at) < load(np.float32, box + at)
        is_out |= load(np.float32, cell + HIGH + at) > load(np.float32, box + HIGH + at)
        if other != axis and axes >> other & ONE_U64 != ZERO_U64 and is_out:
            return False
    return True


@device
def count_raw_nodes(leaf, tree, is_covered, pending):
    """Count the raw nodes behind a leaf's faces, and mark subtrees that a face covers.

    Parameters
    ----------
    leaf : uint64
    tree : RopeTree
    is_covered : uint64
        Address of a byte for each face of each node, 1 for covered subtrees. Changed.
    pending : uint64
        Address of `PENDING_BYTES` of scratch.

    Returns
    -------
    uint64
    """
    box, count = tree.boxes + leaf * BOX_BYTES, ZERO_U64
    for face in range(_SIX):
        rope = load(np.int32, tree.ropes + leaf * ROPE_BYTES + face * WORD)
        if rope == _NOWHERE:
            continue
        store(pending, np.uint64(rope))
        top = pending + _PENDING
        while top != pending:
            top -= _PENDING
            node = push_rope(tree.nodes, load(np.uint64, top), face, box)
            if is_leaf(tree.nodes, node):
                continue
            if _covers(box, tree.boxes + node * BOX_BYTES, face, _axes(tree, node)):
                store(is_covered + node * _SIX + face, _YES)
                continue
            count += ONE_U64
            _, first, _ = split_of(tree.nodes, node)
            store(top, first)
            store(top + _PENDING, first + ONE_U64)
            top += _PENDING + _PENDING
    return count


@device
def _axes(tree, node):
    return np.uint64(load(np.uint8, tree.axes + node))


@device
def propagate_marks(nodes, node, is_covered):
    """Mark what the link nodes of a marked subtree need; returns their number at its root."""
    total = ZERO_U64
    axis, first, _ = split_of(nodes, node)
    if axis == _LEAF:
        return total
    for face in range(_SIX):
        if load(np.uint8, is_covered + node * _SIX + face) != _YES:
            continue
        if face >> ONE_U64 == axis:
            touching = first + (ONE_U64 - (face & ONE_U64))
            store(is_covered + touching * _SIX + face, _YES)
            continue
        total += ONE_U64
        store(is_covered + first * _SIX + face, _YES)
        store(is_covered + (first + ONE_U64) * _SIX + face, _YES)
    return total


@device
def write_raw_nodes(leaf, tree, sectors, covered, number, raw, links, pending):
    """Write the raw nodes behind a leaf's faces, and the raw links of its faces.

    Parameters
    ----------
    leaf : uint64
    tree : RopeTree
    sectors, covered : uint64
        Addresses of the sector of each leaf, and of the links to covered subtrees, uint32.
    number : uint64
        Of the leaf's first raw node.
    raw : uint64
        Address of all raw nodes.
    links : uint64
        Address of the leaf's six raw links.
    pending : uint64
        Address of `PENDING_BYTES` of scratch.
    """
    box = tree.boxes + leaf * BOX_BYTES
    for face in range(_SIX):
        rope = load(np.int32, tree.ropes + leaf * ROPE_BYTES + face * WORD)
        target = links + face * _HALF_ROW
        if rope == _NOWHERE:
            store(target, _VOID)
            continue
        store(pending, np.uint64(rope))
        store(pending + _HALF_ROW, target)
        top = pending + _PENDING
        while top != pending:
            top -= _PENDING
            node = push_rope(tree.nodes, load(np.uint64, top), face, box)
            to = load(np.uint64, top + _HALF_ROW)
            if is_leaf(tree.nodes, node):
                store(to, np.uint64(load(np.uint32, sectors + node * WORD)) * _ROWS)
                continue
            if _covers(box, tree.boxes + node * BOX_BYTES, face, _axes(tree, node)):
                link = load(np.uint32, covered + node * ROPE_BYTES + face * WORD)
                store(to, np.uint64(link))
                continue
            store(to, _RAW_BIT | number)
            to = raw + number * _RAW_BYTES
            number += ONE_U64
            _, first, _ = split_of(tree.nodes, node)
            store(to, node)
            store(top, first)
            store(top + _HALF_ROW, to + _HALF_ROW)
            store(top + _PENDING, first + ONE_U64)
            store(top + _PENDING + _HALF_ROW, to + _HALF_ROW + _HALF_ROW)
            top += _PENDING + _PENDING
