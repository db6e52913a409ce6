"""The steps of a kd-tree's traversals, Foley's three and Horn's, on a small state.

A machine decides when to run which: `traversal.traverse` runs them fused, one ray from start to
end.

A split plane has one distance along a ray, ``fma(plane, inv, middle)``: the slab distance
without padding, from the plane's position alone, so that it is monotone in the position. It
divides the ray's interval into half-open parts: a distance t lies on the near side of the plane
if it is less than the plane's, else on the far side. So each t belongs to exactly one leaf, the
same one in each traversal, and a hit counts in the leaf that its t belongs to, and nowhere
else: no triangle is met twice, and none needs to be remembered.

No ray loops. The interval [t_in, t_out) of a state is never empty: `down` gives a child its
part only if that is not empty, and the last part ends just after the ray's closed end. A leaf
that is left moves t_in to its t_out, which is greater; between two leaves `down` goes to a child
and `up` to a parent, each at most as often as the tree is deep. All t_in but the first are
distances of split planes, so a ray sees no more leaves than there are splits, and one. None of
this needs planes to be in order, or a ray to be off them: a ray in a split plane, or a t_in on
one (Foley 2005, section 4.2, needed "an extra conditional"), has its t compared like any other.

References
----------
Foley and Sugerman, "KD-Tree Acceleration Structures for a GPU Raytracer", Graphics Hardware
2005, Figures 2 to 4, and the kernels of section 3.3.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import fma, load, next_above, store
from raystream.kernels.leaf_block import BLOCK, blocks_end
from raystream.kernels.ray import pick
from raystream.kernels.slab import box_interval
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.short_stack import has_forgotten, pop, push
from raystream.structures.kdtree.state import RESTART, SHORT_STACK, STACK, KdLeaf, KdState

__all__ = ["down", "initialize", "is_at_leaf", "leaf", "leave", "restarts", "up"]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_ZERO = np.float32(0.0)
_WORD = np.uint64(4)
_SECOND_WORD = np.uint64(8)
_AXIS_BITS = np.uint64(3)
_LEAF_AXIS = np.uint64(LEAF_AXIS)
_ENTRY = np.uint64(8)

# Foley's layout; see `packed`.
_LEAF_POINTER = np.uint64(1 << 31)
_AXIS_BIT = np.uint64(30)
_ROW_BITS = np.uint64((1 << 30) - 1)
_RECORD = np.uint64(12)

# Extended splits: their size, and where the high corner and the link are.
_EXTENDED = np.uint64(32)
_HIGH = np.uint64(12)
_LINK = np.uint64(24)


@device
def _distance(line, axis, position):
    """Where a ray meets a plane, and whether it goes up there."""
    inv = pick(axis, line.inv_x, line.inv_y, line.inv_z)
    middle = pick(axis, line.middle_x, line.middle_y, line.middle_z)
    return fma(position, inv, middle), inv > _ZERO


@device
def initialize(tree, ray, t_min, t_max):
    """Begin a search at the root (Foley's Initialize).

    Parameters
    ----------
    tree : KdAddresses
    ray : Ray
    t_min, t_max : float32
        Closed interval in which a hit is wanted.

    Returns
    -------
    is_active : bool
        Whether there is anything to search.
    state : KdState
    """
    low, high = tree.low, tree.high
    t_in, t_out = box_interval(ray, low[0], low[1], low[2], high[0], high[1], high[2])
    # A hit lies in its triangle's interval, so in that of the scene's box.
    t_in, t_out = max(t_in, t_min), min(t_out, t_max)
    t_end = next_above(t_out)
    is_active = tree.nodes != _NONE and t_in <= t_out
    return is_active, KdState(tree.root, t_in, t_end, t_end, _NONE, False)


@device
def is_at_leaf(tree, state):
    """Whether the search is at a leaf."""
    if tree.leaves != _NONE:
        return state.node >= _LEAF_POINTER
    word = np.uint64(load(np.uint32, tree.nodes + state.node * _SECOND_WORD + _WORD))
    return word & _AXIS_BITS == _LEAF_AXIS


@device
def _split_of(tree, node):
    """Position and axis of a split, and its children below and above the plane."""
    if tree.leaves != _NONE:
        at = tree.nodes + node * _RECORD
        below = np.uint64(load(np.uint32, at + _WORD))
        above = np.uint64(load(np.uint32, at + _SECOND_WORD))
        axis = (below >> _AXIS_BIT) & _ONE | ((above >> _AXIS_BIT) & _ONE) << _ONE
        mask = _ROW_BITS | _LEAF_POINTER
        return load(np.float32, at), axis, below & mask, above & mask
    at = tree.nodes + node * _SECOND_WORD
    word = np.uint64(load(np.uint32, at + _WORD))
    below = word >> _TWO
    return load(np.float32, at), word & _AXIS_BITS, below, below + _ONE


@device
def down(tree, line, state, stack):
    """Go from a split to the child that holds t_in (Foley's Down).

    Parameters
    ----------
    tree : KdAddresses
    line : SplitRay
    state : KdState
        At a split.
    stack : uint64
        Address of `STACK_BYTES`, or of `SHORT_STACK_BYTES`; for those that have one.

    Returns
    -------
    KdState
    """
    position, axis, below, above = _split_of(tree, state.node)
    t, is_upward = _distance(line, axis, position)
    first = below if is_upward else above
    second = above if is_upward else below
    node, t_out, top = first, state.t_out, state.top
    if t <= state.t_in:
        node = second
    elif t < state.t_out:
        if tree.traversal == STACK:
            store(stack + top, np.uint32(second))
            store(stack + (top + _WORD), state.t_out)
            top += _ENTRY
        elif tree.traversal == SHORT_STACK:
            top = push(stack, state, second)
        t_out = t
    return KdState(node, state.t_in, t_out, state.t_end, top, False)


@device
def leaf(tree, state):
    """Find the triangles of the leaf that the search is at (Foley's Leaf)."""
    if tree.leaves != _NONE:
        at = tree.leaves + (state.node & _ROW_BITS) * _RECORD
        count = np.uint64(load(np.uint32, at))
        first = np.uint64(load(np.uint32, at + _WORD))
    else:
        at = tree.nodes + state.node * _SECOND_WORD
        first = np.uint64(load(np.uint32, at))
        count = np.uint64(load(np.uint32, at + _WORD)) >> _TWO
    block = tree.blocks + first * BLOCK
    return KdLeaf(block, blocks_end(block, count), count)


@device
def restarts(tree, state):
    """Whether `leave` is going to begin again, at the root or below."""
    if tree.traversal == SHORT_STACK:
        return has_forgotten(state)
    return tree.traversal == RESTART


@device
def leave(tree, state, stack):
    """Go on after a leaf (Foley's Continue).

    Parameters
    ----------
    tree : KdAddresses
    state : KdState
        At the leaf; its t_out must be before t_end.
    stack : uint64

    Returns
    -------
    KdState
        At the next split or leaf to search; or climbing.
    """
    t_in, t_end = state.t_out, state.t_end
    if tree.traversal == STACK:
        # The child on top begins where the leaf ends: only then was it put there.
        top = state.top - _ENTRY
        node = np.uint64(load(np.uint32, stack + top))
        t_out = load(np.float32, stack + (top + _WORD))
        return KdState(node, t_in, t_out, t_end, top, False)
    if tree.traversal == SHORT_STACK:
        return pop(stack, state)
    if tree.traversal == RESTART:
        return KdState(tree.root, t_in, t_end, t_end, _NONE, False)
    return KdState(state.node, t_in, t_end, t_end, _NONE, True)


@device
def up(tree, line, state):
    """Go to the parent of a node; stay there if it holds t_in (Foley's Up).

    Parameters
    ----------
    tree : KdAddresses
    line : SplitRay
    state : KdState
        Climbing.

    Returns
    -------
    KdState

    Notes
    -----
    Nodes above hold all that was searched, so only where the ray leaves one is in question:
    at the first of the planes that the ray goes towards. The root has none.
    """
    if tree.leaves == _NONE:
        row = tree.extended + ((state.node - _ONE) >> _ONE) * _EXTENDED
        node = np.uint64(load(np.uint32, row + _LINK))
    else:
        if state.node >= _LEAF_POINTER:
            at = tree.leaves + (state.node & _ROW_BITS) * _RECORD + _SECOND_WORD
        else:
            at = tree.extended + state.node * _EXTENDED + _LINK
        node = np.uint64(load(np.uint32, at))
        row = tree.extended + node * _EXTENDED
    high = row + _HIGH
    x = load(np.float32, high if line.inv_x > _ZERO else row)
    y = load(np.float32, (high if line.inv_y > _ZERO else row) + _WORD)
    z = load(np.float32, (high if line.inv_z > _ZERO else row) + _SECOND_WORD)
    t_out = min(
        fma(x, line.inv_x, line.middle_x),
        fma(y, line.inv_y, line.middle_y),
        fma(z, line.inv_z, line.middle_z),
    )
    is_climbing = not state.t_in < t_out
    return KdState(node, state.t_in, min(t_out, state.t_end), state.t_end, state.top, is_climbing)
