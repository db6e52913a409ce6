"""The steps of a kd-tree's traversals, Foley's three and Horn's, on a small state.

A machine decides when to run which: `traversal.traverse` runs them fused, one ray from start to
end. What the traversals differ in is in `traversals`, a file each; what nodes say, in `layouts`.

A split plane has one distance along a ray, ``fma(plane, inv, middle)``: the slab distance
without padding, from the plane's position alone, so that it is monotone in the position. It
divides the ray's interval into half-open parts: a distance t lies on the near side of the plane
if it is less than the plane's, else on the far side. So each t belongs to exactly one leaf, the
same one in each traversal, and a hit counts in the leaf that its t belongs to, and nowhere
else: no triangle is met twice, and none needs to be remembered.

No ray loops. The interval [t_in, t_out) of a state is never empty: `descend` gives a child its
part only if that is not empty, and the last part ends just after the ray's closed end. A leaf
that is left moves t_in to its t_out, which is greater; between two leaves `descend` goes to a
child and `backtrack` to a parent, each at most as often as the tree is deep. All t_in but the
first are distances of split planes, so a ray sees no more leaves than there are splits, and one.
None of this needs planes to be in order, or a ray to be off them: a ray in a split plane, or a
t_in on one (Foley 2005, section 4.2, needed "an extra conditional"), has its t compared like any
other.

References
----------
Foley and Sugerman, "KD-Tree Acceleration Structures for a GPU Raytracer", Graphics Hardware
2005, Figures 2 to 4, and the kernels of section 3.3.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import fma, next_float_up
from raystream.kernels.ray import component
from raystream.kernels.slab import box_interval
from raystream.structures.kdtree.layouts import is_leaf, leaf_of, split_of
from raystream.structures.kdtree.state import KdState
from raystream.structures.kdtree.traversals import continue_search, push, restarts
from raystream.structures.kdtree.traversals.backtrack import backtrack

__all__ = [
    "backtrack",
    "continue_search",
    "descend",
    "initialize",
    "is_at_leaf",
    "leaf",
    "restarts",
]

_NONE = np.uint64(0)
_ZERO = np.float32(0.0)


@device
def _distance(line, axis, position):
    """Where a ray meets a plane, and whether it goes up there."""
    inv = component(axis, line.inv_x, line.inv_y, line.inv_z)
    middle = component(axis, line.middle_x, line.middle_y, line.middle_z)
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
    t_end = next_float_up(t_out)
    is_active = tree.nodes != _NONE and t_in <= t_out
    return is_active, KdState(tree.root, t_in, t_end, t_end, _NONE, False)


@device
def is_at_leaf(tree, state):
    """Whether the search is at a leaf."""
    return is_leaf(tree, state.node)


@device
def descend(tree, line, state, stack):
    """Go from a split to the child that holds t_in (Foley's Down).

    Parameters
    ----------
    tree : KdAddresses
    line : SplitRay
    state : KdState
        At a split.
    stack : uint64
        See `traversals.push`.

    Returns
    -------
    KdState
    """
    split = split_of(tree, state.node)
    t, is_upward = _distance(line, split.axis, split.position)
    first = split.below if is_upward else split.above
    second = split.above if is_upward else split.below
    node, t_out, top = first, state.t_out, state.top
    if t <= state.t_in:
        node = second
    elif t < state.t_out:
        top = push(tree, stack, state, second)
        t_out = t
    return KdState(node, state.t_in, t_out, state.t_end, top, False)


@device
def leaf(tree, state):
    """Find the triangles of the leaf that the search is at (Foley's Leaf)."""
    return leaf_of(tree, state.node)
