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

from raystream.jit.cpu import kernel
from raystream.structures.kdtree.layout import LEAF_AXIS

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


@kernel
def _pack(nodes, bits, rows, splits, leaves):
    split_count, leaf_count = 0, 0
    for node in range(len(nodes)):
        if nodes[node, 1] & 3 == LEAF_AXIS:
            rows[node] = leaf_count
            leaf_count += 1
        else:
            rows[node] = split_count
            split_count += 1
    leaves[0, 2] = _NO_PARENT
    for node in range(len(nodes)):
        axis, number, row = nodes[node, 1] & 3, nodes[node, 1] >> 2, rows[node]
        if axis == LEAF_AXIS:
            leaves[row, 0], leaves[row, 1] = number, bits[node, 0]
            continue
        splits[row, 0] = bits[node, 0]
        for side in range(2):
            child = number + side
            word = np.int64(rows[child]) | np.int64((axis >> side) & 1) << AXIS_BIT
            if nodes[child, 1] & 3 == LEAF_AXIS:
                word |= np.int64(1) << LEAF_BIT
                leaves[rows[child], 2] = row
            splits[row, 1 + side] = np.uint32(word)


def pack(nodes: NDArray[np.int32]) -> FoleyArrays:
    """Convert a tree of at least one node to Foley's layout."""
    split_count = len(nodes) // 2
    packed = FoleyArrays(
        np.empty((split_count, 3), np.uint32), np.empty((split_count + 1, 3), np.uint32)
    )
    _pack(nodes, nodes.view(np.uint32), np.empty(len(nodes), np.int32), *packed)
    return packed


@kernel
def _extend(nodes, positions, is_packed, rows, parents, bounds, links):
    split_count = 0
    for node in range(len(nodes)):
        axis, left = nodes[node, 1] & 3, nodes[node, 1] >> 2
        if axis == LEAF_AXIS:
            continue
        row = split_count if is_packed else left >> 1
        split_count += 1
        rows[node] = row
        parents[left] = parents[left + 1] = node
        if node == 0:
            for k in range(3):
                bounds[row, k], bounds[row, k + 3] = -np.inf, np.inf
            links[row, 6] = _NO_PARENT
        else:
            parent = parents[node]
            split_axis = nodes[parent, 1] & 3
            for k in range(6):
                bounds[row, k] = bounds[rows[parent], k]
            if node & 1:  # below its parent's plane
                k = split_axis + 3
                bounds[row, k] = min(bounds[row, k], positions[parent, 0])
            else:
                bounds[row, split_axis] = max(bounds[row, split_axis], positions[parent, 0])
            links[row, 6] = rows[parent]
        if not is_packed:
            links[row, 6] = node
        links[row, 7] = 0


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
    extended = np.empty((len(nodes) // 2, 8), np.float32)
    rows, parents = (np.zeros(len(nodes), np.int32) for _ in range(2))
    _extend(
        nodes,
        nodes.view(np.float32),
        is_packed,
        rows,
        parents,
        extended,
        extended.view(np.int32),
    )
    return extended
