"""Traversing the kd-tree: the steps of Foley's traversals and Horn's, and the loop that joins them.

The traversals differ in how they continue after a leaf only: one file each in `traversals`. The
multipass machine runs the steps as kernels of their own; `traverse` runs them fused.

A split plane has one distance along a ray (`plane_distances`). It divides the ray's interval into
half-open parts: a distance t lies on the near side of the plane if it is less than the plane's,
else on the far side. So each t belongs to exactly one leaf, the same in every traversal, and a hit
counts in the leaf that its t belongs to and nowhere else: no triangle is hit twice, and none needs
to be remembered.

Every search ends. The interval [t_in, t_out) of a state is never empty: `descend` gives a child its
part only if that is not empty, and the last part ends just after the ray's closed end. Leaving a
leaf moves t_in to its t_out, which is greater; between two leaves `descend` goes to a
child and `backtrack` to a parent, each at most as often as the tree is deep. All t_in but the
first are distances of split planes, so a ray visits at most one leaf more than there are splits.
None of this requires planes to be in order, or a ray to be off them: the t of a ray in a split
plane, or a t_in on one (Foley 2005, section 4.2, needed "an extra conditional"), is compared like
any other.

References
----------
Foley and Sugerman, "KD-Tree Acceleration Structures for a GPU Raytracer", Graphics Hardware
2005, Figures 2 to 4, and the kernels of section 3.3.
"""

from __future__ import annotations

from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import next_float_up
from raystream.kernels.leaf_block import block_ray, search_blocks
from raystream.kernels.search import is_full, is_over
from raystream.kernels.tally import (
    BACKTRACK_STEPS,
    BACKTRACKS,
    LEAVES,
    RESTARTS,
    STEPS,
    add_to,
)
from raystream.structures.kdtree.nodes import is_leaf, leaf_of, split_of
from raystream.structures.kdtree.state import KdState
from raystream.structures.kdtree.traversals import continue_search, push, restarts
from raystream.structures.kdtree.traversals.backtrack import backtrack
from raystream.structures.plane_distances import plane_distance, scene_interval, split_ray


@device
def initialize(tree, ray, t_min, t_max):
    """Begin a search at the root (Foley's Initialize).

    Parameters
    ----------
    tree : KdAddresses
    ray : Ray
    t_min, t_max : float32
        Closed interval of the search.

    Returns
    -------
    is_active : bool
        Whether the ray can hit anything.
    state : KdState
    """
    t_in, t_out = scene_interval(tree, ray, t_min, t_max)
    t_end = next_float_up(t_out)
    is_active = tree.nodes != NULL and t_in <= t_out
    return is_active, KdState(tree.root, t_in, t_end, t_end, ZERO_U64, False)


@device
def descend(tree, line, state, stack):
    """Go from a split to the child that contains t_in (Foley's Down).

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
    t, is_upward = plane_distance(line, split.axis, split.position)
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
def traverse(tree, ray, search, stack):
    """Search the leaves along a ray; see `kernels.queries.ray_queries` for the arguments."""
    is_active, state = initialize(tree, ray, search.t_min, search.t_far)
    if not is_active:
        return search
    line, triangle_ray = split_ray(ray), block_ray(ray)
    while True:
        while not is_leaf(tree, state.node):
            state = descend(tree, line, state, stack)
            add_to(search.counters, STEPS, ONE_U64)
        triangles = leaf_of(tree, state.node)
        add_to(search.counters, LEAVES, ONE_U64)
        search = search_blocks(
            triangles.block, triangles.end, triangle_ray, search, state.t_in, state.t_out
        )
        if is_full(search):
            return search
        if is_over(search, state.t_out) or state.t_out >= state.t_end:
            return search
        if restarts(tree, state):
            add_to(search.counters, RESTARTS, ONE_U64)
        state = continue_search(tree, state, stack)
        if state.is_backtracking:
            add_to(search.counters, BACKTRACKS, ONE_U64)
        while state.is_backtracking:
            state = backtrack(tree, line, state)
            add_to(search.counters, BACKTRACK_STEPS, ONE_U64)
