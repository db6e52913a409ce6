"""The cells of a kd-tree: their boxes, and the ropes of their faces."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, THREE_U64, TWO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, load, store
from raystream.structures.clip import BOX_BYTES, HIGH, WORD
from raystream.structures.kdtree.layout import LEAF_AXIS

#: Bytes of a node of the tree, and of a cell's six ropes.
NODE_BYTES = np.uint64(8)
ROPE_BYTES = np.uint64(24)

_SIX = np.uint64(6)
_LEAF = np.uint64(LEAF_AXIS)
_NOWHERE = np.int32(-1)


class Cells(NamedTuple):
    """The cells of a kd-tree, in the order of its nodes.

    Attributes
    ----------
    boxes : ndarray of shape (M, 6), float32
        Low x, y, z, high x, y, z.
    ropes : ndarray of shape (M, 6), int32
        For each face, in the order of `layout.FACES`: the root of the smallest subtree that
        covers the other side of it, or -1 at the side of the root's box.
    """

    boxes: NDArray[np.float32]
    ropes: NDArray[np.int32]


@device
def split_of(nodes, node):
    """A node's axis, or 3 for a leaf; its first child; its plane."""
    at = nodes + node * NODE_BYTES
    word = np.uint64(load(np.uint32, at + WORD))
    return word & THREE_U64, word >> TWO_U64, load(np.float32, at)


@device
def is_leaf(nodes, node):
    """Whether a node is a leaf."""
    axis, _, _ = split_of(nodes, node)
    return axis == _LEAF


@device
def push_rope(nodes, node, face, box):
    """Descend to the smallest subtree that covers the other side of a box's face.

    Parameters
    ----------
    nodes : uint64
        Address of the tree.
    node : uint64
        A subtree that covers it.
    face : uint64
        See `layout.FACES`.
    box : uint64
        Address.

    Returns
    -------
    uint64
    """
    face_axis = face >> ONE_U64
    # A high face touches the low side of its neighbours.
    touching = ONE_U64 - (face & ONE_U64)
    while True:
        axis, child, plane = split_of(nodes, node)
        if axis == _LEAF:
            return node
        side = box + axis * WORD
        if axis == face_axis:
            node = child + touching
        elif plane <= load(np.float32, side):
            node = child + ONE_U64
        elif plane >= load(np.float32, side + HIGH):
            node = child
        else:
            return node


@device
def write_children(nodes, node, boxes, ropes):
    """Write the boxes and ropes of a split's children, given addresses; see `Cells`."""
    axis, first, plane = split_of(nodes, node)
    for side in range(TWO_U64):
        child = first + side
        box, rope = boxes + child * BOX_BYTES, ropes + child * ROPE_BYTES
        for k in range(_SIX):
            at = k * WORD
            store(box + at, load(np.float32, boxes + node * BOX_BYTES + at))
            store(rope + at, load(np.int32, ropes + node * ROPE_BYTES + at))
        # The plane is the high side of the cell below it, and the low side of the other.
        inner = ONE_U64 - side
        store(box + (axis + THREE_U64 * inner) * WORD, plane)
        store(rope + (TWO_U64 * axis + inner) * WORD, np.int32(first + inner))
        for face in range(_SIX):
            other = load(np.int32, rope + face * WORD)
            if other != _NOWHERE:
                pushed = push_rope(nodes, np.uint64(other), face, box)
                store(rope + face * WORD, np.int32(pushed))


@kernel
def _find_cells(nodes, boxes, ropes):
    """Fill in the cells of a tree from its root, whose box and ropes are given."""
    node_at, box_at, rope_at = address(nodes), address(boxes), address(ropes)
    for node in range(np.uint64(len(nodes))):
        if not is_leaf(node_at, node):
            write_children(node_at, node, box_at, rope_at)


def find_cells(nodes: NDArray[np.int32], box: NDArray[np.float32]) -> Cells:
    """Compute the cells of a tree.

    Parameters
    ----------
    nodes : ndarray of shape (M, 2), int32
        `kdtree.layout.KdArrays.nodes`, at least one.
    box : ndarray of shape (2, 3), float32
        The root's.

    Returns
    -------
    Cells
    """
    boxes = np.empty((len(nodes), 6), np.float32)
    ropes = np.empty((len(nodes), 6), np.int32)
    boxes[0], ropes[0] = box.ravel(), _NOWHERE
    _find_cells(nodes, boxes, ropes)
    return Cells(boxes, ropes)
