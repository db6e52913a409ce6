"""Foley's layout of a kd-tree, and the extended splits that backtracking needs in either layout.

References
----------
Foley and Sugerman, "KD-Tree Acceleration Structures for a GPU Raytracer", Graphics Hardware
2005, Figure 5: a Split holds the position of its plane and pointers to both children, whose
sign bits say which child is a leaf, and the axis; a Leaf holds its number of triangles, the
first one, and its parent; an ExtendedSplit holds the bounds and the parent of a Split.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.structures.kdtree.layout import LEAF_AXIS, find_cells

#: Bits of a pointer: that it leads to a leaf; a bit of the split's axis.
LEAF_BIT = 31
AXIS_BIT = 30

#: The parent of the root.
_NO_PARENT = 2**30 - 1


class FoleyArrays(NamedTuple):
    """Foley's layout.

    Attributes
    ----------
    splits : ndarray of shape (S, 3), uint32
        Position of the plane, as the bits of a float32; pointers to the children below and
        above it: a row of `splits`, or of `leaves` if bit 31 is set. Bit 30 of the first is
        the low bit of the axis, of the second the high one.
    leaves : ndarray of shape (S + 1, 3), uint32
        Number of triangles, first block, row of the parent in `splits`.

    Notes
    -----
    12 bytes per node, as in the paper, whose pointers are pairs of int16.
    """

    splits: NDArray[np.uint32]
    leaves: NDArray[np.uint32]


def _parents(left: NDArray[np.int32], node_count: int) -> NDArray[np.int32]:
    """The row of each node's parent among the splits, whose left children are given."""
    parents = np.full(node_count, _NO_PARENT, np.int32)
    parents[left] = parents[left + 1] = np.arange(len(left))
    return parents


def pack(nodes: NDArray[np.int32]) -> FoleyArrays:
    """Convert a tree of at least one node to Foley's layout."""
    axis, number, first_words = nodes[:, 1] & 3, nodes[:, 1] >> 2, nodes.view(np.uint32)[:, 0]
    is_leaf = axis == LEAF_AXIS
    is_split = ~is_leaf
    left, axis = number[is_split], axis[is_split].astype(np.uint32)
    # A node's pointer: its row among the leaves or among the splits, and which of the two.
    pointers = (np.where(is_leaf, np.cumsum(is_leaf), np.cumsum(is_split)) - 1).astype(np.uint32)
    pointers |= is_leaf.astype(np.uint32) << LEAF_BIT
    # The two bits of a split's axis are in the pointers to its children.
    below, above = (pointers[left + k] | (axis >> k & 1) << AXIS_BIT for k in range(2))
    parents = _parents(left, len(nodes))[is_leaf]
    leaves = number[is_leaf].astype(np.uint32), first_words[is_leaf], parents.astype(np.uint32)
    return FoleyArrays(
        np.column_stack([first_words[is_split], below, above]), np.column_stack(leaves)
    )


def extend(nodes: NDArray[np.int32], is_packed: bool) -> NDArray[np.float32]:
    """Make the extended splits of a tree: Foley's ExtendedSplit.

    Parameters
    ----------
    nodes : ndarray of shape (M, 2), int32
        A tree of at least one node.
    is_packed : bool
        Whether rows are in the order of `FoleyArrays.splits`. Else the row of a split is half that
        of its left child, so that the parent of node n is in row (n - 1) / 2 and leaves need no
        pointer.

    Returns
    -------
    ndarray of shape (S, 8), float32
        Low x, y, z, high x, y, z; infinite at the border of the scene, where no plane ends the
        search. Then, as the bits of an int32, the parent's row; without `is_packed` the split's
        own row in `nodes`. The last number is 0: 32 bytes per split, as in the paper.
    """
    splits = np.flatnonzero(nodes[:, 1] & 3 != LEAF_AXIS)
    left = nodes[splits, 1] >> 2
    boxes = np.empty((len(nodes), 6), np.float32)
    boxes[0, :3], boxes[0, 3:] = -np.inf, np.inf
    find_cells(nodes, nodes.view(np.float32), boxes, np.zeros(len(nodes), np.int32))
    extended = np.zeros((len(splits), 8), np.float32)
    rows = np.arange(len(splits)) if is_packed else left >> 1
    extended[rows, :6] = boxes[splits]
    links = _parents(left, len(nodes))[splits] if is_packed else splits
    extended.view(np.int32)[rows, 6] = links
    return extended
