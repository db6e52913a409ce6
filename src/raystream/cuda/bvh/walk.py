"""The walk of binary nodes: a while-while loop over nodes and leaves, for all that has boxes.

The threads of a warp converge where all of them visit nodes, or all are at leaves. So a thread
visits nodes until it reaches a leaf, then leaves until it reaches a node.

References
----------
Aila, Laine, "Understanding the Efficiency of Ray Traversal on GPUs", High Performance Graphics
2009: the while-while kernel, without its speculative variant, which polls the other threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.jit.constants import NULL
from raystream.jit.cpu import device
from raystream.jit.simd import f32x4, float_as_bits, lane, load, load_constant, store
from raystream.kernels.slab import box_interval

#: The root's row, and links that are no row: the latest one on the stack, and none.
ROOT = np.int32(0)
NEXT, DONE = np.int32(2**31 - 2), np.int32(2**31 - 1)

#: Bytes of a stack's entry: a link; with distances, that of its box behind it.
ENTRY = np.uint64(4)

_NODE = np.uint64(64)
_SECOND_ROW, _SECOND_CHILD = np.uint64(16), np.uint64(32)


def binary_walk(
    interval: Callable[..., Any],
    enter: Callable[..., Any],
    at_leaf: Callable[..., Any],
    *,
    has_distances: bool = False,
) -> Callable[..., Any]:
    """Make the walk of binary nodes.

    Parameters
    ----------
    interval : device function
        ``interval(line, search) -> (near, far, last)``: the closed interval of distances in which
        boxes are wanted; see `structures.bvh.walks.single.tree_walk`.
    enter : device function
        ``enter(box, line, search, near, far) -> (distance, is_entered)`` for a child's box, a tuple
        (low x, high x, low y, high y, low z, high z) of float32. The child at the lesser distance
        is visited first.
    at_leaf : device function
        ``at_leaf(tree, line, search, link, stack, top) -> (tree, line, search, link, top)`` at a
        negative link: the next link is `NEXT`, `DONE` or, in another tree, `ROOT`, which may need
        another line of the same type; see `one_tree`.
    has_distances : bool
        Whether distances are float32, and kept with links on the stack, which then is twice as
        large: so boxes that have left the interval are not visited.

    Returns
    -------
    device function
        ``walk(tree, line, search, stack) -> search``. `tree` has the address of the root,
        ``nodes``, 0 for an empty tree; `line` is the ray or point as the functions take it.
    """
    entry = ENTRY + ENTRY if has_distances else ENTRY

    @device
    def pop(stack, top, far):
        while top != stack:
            top -= entry
            if not has_distances or load(np.float32, top + ENTRY) <= far:
                return load(np.int32, top), top
        return DONE, top

    @device
    def walk(tree, line, search, stack):
        near, far, _ = interval(line, search)
        # Written so that a NaN ends it.
        link = ROOT if tree.nodes != NULL and near <= far else DONE
        top = stack
        while link != DONE:
            while link >= ROOT and link != DONE:
                at = tree.nodes + np.uint64(link) * _NODE
                left_box, left = _child(at)
                right_box, right = _child(at + _SECOND_CHILD)
                left_distance, enters_left = enter(left_box, line, search, near, far)
                right_distance, enters_right = enter(right_box, line, search, near, far)
                if enters_left and enters_right:
                    is_right_nearer = right_distance < left_distance
                    store(top, left if is_right_nearer else right)
                    if has_distances:
                        store(top + ENTRY, max(left_distance, right_distance))
                    top += entry
                    link = right if is_right_nearer else left
                elif enters_left or enters_right:
                    link = left if enters_left else right
                else:
                    link, top = pop(stack, top, far)
            while link < ROOT:
                tree, line, search, link, top = at_leaf(tree, line, search, link, stack, top)
                near, far, _ = interval(line, search)
                if link == NEXT:
                    link, top = pop(stack, top, far)
        return search

    return walk


@device
def _child(at):
    """The box of a child of a node, and its link."""
    sides = load_constant(f32x4, at)
    rest = load_constant(f32x4, at + _SECOND_ROW)
    box = lane(sides, 0), lane(sides, 1), lane(sides, 2), lane(sides, 3), lane(rest, 0)
    return (*box, lane(rest, 1)), lane(float_as_bits(rest), 2)


def one_tree(visit_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the `at_leaf` of a walk in one tree with a leaf of `walks.single.tree_walk`."""

    @device
    def at_leaf(tree, line, search, link, stack, top):
        search, is_over = visit_leaf(tree, link, line, search, stack)
        return tree, line, search, DONE if is_over else NEXT, top

    return at_leaf


@device
def _interval(_ray, search):
    return search.t_min, search.t_far, search.t_far


@device
def _enter(box, ray, _search, near, far):
    low_x, high_x, low_y, high_y, low_z, high_z = box
    t_in, t_out = box_interval(ray, low_x, low_y, low_z, high_x, high_y, high_z)
    return t_in, max(t_in, near) <= min(t_out, far)


def ray_traversal(at_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the traversal of a `Ray`; see `kernels.queries.ray_queries` for its arguments."""
    return binary_walk(_interval, _enter, at_leaf)
