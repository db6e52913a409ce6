"""What the nodes of a kd-tree say, in whichever of the two layouts they are.

A tree of 8-byte nodes has no array of leaves: `KdAddresses.leaves` is None, which is known when a
kernel is compiled, so that code for the other layout is left out.
"""

from __future__ import annotations

from raystream.jit.cpu import device
from raystream.structures.kdtree.layouts import compact, foley

__all__ = ["is_leaf", "leaf_of", "parent_of", "split_of"]


@device
def _is_leaf(leaves, tree, node):
    if leaves is None:
        return compact.is_leaf(tree, node)
    return foley.is_leaf(tree, node)


@device
def is_leaf(tree, node):
    """Whether a node is a leaf."""
    return _is_leaf(tree.leaves, tree, node)


@device
def _split_of(leaves, tree, node):
    if leaves is None:
        return compact.split_of(tree, node)
    return foley.split_of(tree, node)


@device
def split_of(tree, node):
    """The plane and the children of a node that is split; a `KdSplit`."""
    return _split_of(tree.leaves, tree, node)


@device
def _leaf_of(leaves, tree, node):
    if leaves is None:
        return compact.leaf_of(tree, node)
    return foley.leaf_of(tree, node)


@device
def leaf_of(tree, node):
    """The triangles of a leaf; a `KdLeaf`."""
    return _leaf_of(tree.leaves, tree, node)


@device
def _parent_of(leaves, tree, node):
    if leaves is None:
        return compact.parent_of(tree, node)
    return foley.parent_of(tree, node)


@device
def parent_of(tree, node):
    """The node above, and the address of its record of what `packed.extend` gives."""
    return _parent_of(tree.leaves, tree, node)
