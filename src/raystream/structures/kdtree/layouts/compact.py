"""Nodes of 8 bytes; children lie side by side. See `layout.KdArrays`."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.leaf_block import BLOCK, blocks_end
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.state import EXTENDED, EXTENDED_LINK, KdLeaf, KdSplit

__all__ = ["is_leaf", "leaf_of", "parent_of", "split_of"]

_ONE = np.uint64(1)
_AXIS_BITS = np.uint64(3)
_LEAF_AXIS = np.uint64(LEAF_AXIS)
_AXIS_SHIFT = np.uint64(2)

# Bytes of a node, and where its second word is.
_NODE = np.uint64(8)
_SECOND = np.uint64(4)


@device
def is_leaf(tree, node):
    """Whether a node is a leaf."""
    word = np.uint64(load(np.uint32, tree.nodes + node * _NODE + _SECOND))
    return word & _AXIS_BITS == _LEAF_AXIS


@device
def split_of(tree, node):
    """The plane and the children of a node that is split."""
    at = tree.nodes + node * _NODE
    word = np.uint64(load(np.uint32, at + _SECOND))
    below = word >> _AXIS_SHIFT
    return KdSplit(load(np.float32, at), word & _AXIS_BITS, below, below + _ONE)


@device
def leaf_of(tree, node):
    """The triangles of a leaf."""
    at = tree.nodes + node * _NODE
    block = tree.blocks + np.uint64(load(np.uint32, at)) * BLOCK
    count = np.uint64(load(np.uint32, at + _SECOND)) >> _AXIS_SHIFT
    return KdLeaf(block, blocks_end(block, count), count)


@device
def parent_of(tree, node):
    """The node above, and the address of its extended record: one for both of its children."""
    record = tree.extended + ((node - _ONE) >> _ONE) * EXTENDED
    return np.uint64(load(np.uint32, record + EXTENDED_LINK)), record
