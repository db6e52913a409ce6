"""The nodes of a kd-tree as kernels read them, in either of its two layouts.

A tree of 8-byte nodes (`layout.KdArrays`) has no array of leaves: `KdAddresses.leaves` is None,
which is known when a kernel is compiled, so that code for Foley's layout (`foley_layout`) is left
out. There, a node is a row of splits, or of leaves if bit 31 is set.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.leaf_block import BLOCK, blocks_end
from raystream.structures.kdtree.foley_layout import AXIS_BIT, LEAF_BIT
from raystream.structures.kdtree.layout import LEAF_AXIS

# 8-byte nodes: bytes of a node; its second word is its left child and its axis.
_NODE = np.uint64(8)
_AXIS_BITS = np.uint64(3)
_LEAF_AXIS = np.uint64(LEAF_AXIS)
_AXIS_SHIFT = np.uint64(2)

# Foley's layout: bytes of a record, and its pointers.
_RECORD = np.uint64(12)
_LEAF_POINTER = np.uint64(1 << LEAF_BIT)
_AXIS_BIT = np.uint64(AXIS_BIT)
_ROW_BITS = np.uint64((1 << AXIS_BIT) - 1)
_NODE_BITS = _ROW_BITS | _LEAF_POINTER

# Byte offsets of words of both.
_SECOND = np.uint64(4)
_THIRD = np.uint64(8)

# Bytes of an extended split (`foley_layout.extend`), and the offset of its link.
_EXTENDED = np.uint64(32)
_EXTENDED_LINK = np.uint64(24)


class KdAddresses(NamedTuple):
    """A tree as kernels take it; the caller keeps its arrays alive.

    Attributes
    ----------
    nodes : uint64
        Address of `layout.KdArrays.nodes`, or of `foley_layout.FoleyArrays.splits`; 0 for an
        empty tree.
    leaves : uint64 or None
        Address of `foley_layout.FoleyArrays.leaves`; None for nodes of 8 bytes.
    extended : uint64
        Address of the extended splits; for `state.BACKTRACK` only.
    blocks : uint64
        Address of the leaf blocks.
    root : uint64
    traversal : uint64
        `state.STACK`, `RESTART`, `BACKTRACK` or `SHORT_STACK`.
    low, high : tuple of three float32
        The scene's box.
    """

    nodes: np.uint64
    leaves: np.uint64 | None
    extended: np.uint64
    blocks: np.uint64
    root: np.uint64
    traversal: np.uint64
    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]


class KdSplit(NamedTuple):
    """A node with a split plane.

    Attributes
    ----------
    position : float32
    axis : uint64
    below, above : uint64
        Its children.
    """

    position: np.float32
    axis: np.uint64
    below: np.uint64
    above: np.uint64


class KdLeaf(NamedTuple):
    """The triangles of a leaf.

    Attributes
    ----------
    block, end : uint64
        Addresses of its first block, and after its last one.
    triangle_count : uint64
    """

    block: np.uint64
    end: np.uint64
    triangle_count: np.uint64


@device
def _is_leaf(leaves, tree, node):
    if leaves is None:
        word = np.uint64(load(np.uint32, tree.nodes + node * _NODE + _SECOND))
        return word & _AXIS_BITS == _LEAF_AXIS
    return node >= _LEAF_POINTER


@device
def is_leaf(tree, node):
    """Whether a node is a leaf."""
    return _is_leaf(tree.leaves, tree, node)


@device
def _split_of(leaves, tree, node):
    if leaves is None:
        at = tree.nodes + node * _NODE
        word = np.uint64(load(np.uint32, at + _SECOND))
        left = word >> _AXIS_SHIFT
        return KdSplit(load(np.float32, at), word & _AXIS_BITS, left, left + ONE_U64)
    at = tree.nodes + node * _RECORD
    below = np.uint64(load(np.uint32, at + _SECOND))
    above = np.uint64(load(np.uint32, at + _THIRD))
    axis = (below >> _AXIS_BIT) & ONE_U64 | ((above >> _AXIS_BIT) & ONE_U64) << ONE_U64
    return KdSplit(load(np.float32, at), axis, below & _NODE_BITS, above & _NODE_BITS)


@device
def split_of(tree, node):
    """The plane and the children of an inner node: a `KdSplit`."""
    return _split_of(tree.leaves, tree, node)


@device
def _leaf_of(leaves, tree, node):
    if leaves is None:
        at = tree.nodes + node * _NODE
        first = np.uint64(load(np.uint32, at))
        count = np.uint64(load(np.uint32, at + _SECOND)) >> _AXIS_SHIFT
    else:
        at = leaves + (node & _ROW_BITS) * _RECORD
        count = np.uint64(load(np.uint32, at))
        first = np.uint64(load(np.uint32, at + _SECOND))
    block = tree.blocks + first * BLOCK
    return KdLeaf(block, blocks_end(block, count), count)


@device
def leaf_of(tree, node):
    """The triangles of a leaf: a `KdLeaf`."""
    return _leaf_of(tree.leaves, tree, node)


@device
def _parent_of(leaves, tree, node):
    if leaves is None:
        # One record for both of a split's children.
        record = tree.extended + ((node - ONE_U64) >> ONE_U64) * _EXTENDED
        return np.uint64(load(np.uint32, record + _EXTENDED_LINK)), record
    if node >= _LEAF_POINTER:
        at = leaves + (node & _ROW_BITS) * _RECORD + _THIRD
    else:
        at = tree.extended + node * _EXTENDED + _EXTENDED_LINK
    parent = np.uint64(load(np.uint32, at))
    return parent, tree.extended + parent * _EXTENDED


@device
def parent_of(tree, node):
    """The parent of a node, and the address of its extended split."""
    return _parent_of(tree.leaves, tree, node)
