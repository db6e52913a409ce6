"""Foley's layout (Foley 2005, Figure 5): splits and leaves of 12 bytes. See `packed`."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.leaf_block import BLOCK, blocks_end
from raystream.structures.kdtree.state import EXTENDED, EXTENDED_LINK, KdLeaf, KdSplit

__all__ = ["is_leaf", "leaf_of", "parent_of", "split_of"]

_ONE = np.uint64(1)

#: A node is a row of splits; or, with this bit, of leaves.
_LEAF_POINTER = np.uint64(1 << 31)
_AXIS_BIT = np.uint64(30)
_ROW_BITS = np.uint64((1 << 30) - 1)
_NODE_BITS = _ROW_BITS | _LEAF_POINTER

# Bytes of a record, and where its second and third words are.
_RECORD = np.uint64(12)
_SECOND = np.uint64(4)
_THIRD = np.uint64(8)


@device
def is_leaf(tree, node):
    """Whether a node is a leaf."""
    return node >= _LEAF_POINTER


@device
def split_of(tree, node):
    """The plane and the children of a node that is split."""
    at = tree.nodes + node * _RECORD
    below = np.uint64(load(np.uint32, at + _SECOND))
    above = np.uint64(load(np.uint32, at + _THIRD))
    axis = (below >> _AXIS_BIT) & _ONE | ((above >> _AXIS_BIT) & _ONE) << _ONE
    return KdSplit(load(np.float32, at), axis, below & _NODE_BITS, above & _NODE_BITS)


@device
def leaf_of(tree, node):
    """The triangles of a leaf."""
    at = tree.leaves + (node & _ROW_BITS) * _RECORD
    count = np.uint64(load(np.uint32, at))
    block = tree.blocks + np.uint64(load(np.uint32, at + _SECOND)) * BLOCK
    return KdLeaf(block, blocks_end(block, count), count)


@device
def parent_of(tree, node):
    """The node above, and the address of its extended record."""
    if node >= _LEAF_POINTER:
        at = tree.leaves + (node & _ROW_BITS) * _RECORD + _THIRD
    else:
        at = tree.extended + node * EXTENDED + EXTENDED_LINK
    parent = np.uint64(load(np.uint32, at))
    return parent, tree.extended + parent * EXTENDED
