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

#: The root's row, and links that are no row: none left.
ROOT = np.int32(0)
DONE = np.int32(2**31 - 1)

#: Bytes of a stack's entry: a link.
ENTRY = np.uint64(4)

_NODE = np.uint64(64)
_SECOND_ROW, _SECOND_CHILD = np.uint64(16), np.uint64(32)


def binary_walk(enter: Callable[..., Any], at_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make a walk of binary nodes.

    Parameters
    ----------
    enter : device function
        ``enter(box, ray, search) -> (distance, is_entered)`` for a child's box, a tuple (low x,
        high x, low y, high y, low z, high z) of float32. The child at the lesser distance is
        visited first.
    at_leaf : device function
        ``at_leaf(tree, ray, search, link, stack, top) -> (tree, ray, search, link, top)`` at a
        negative link: the next link, from `pop` or `DONE`. It may go on in another tree, with
        another ray of the same type; see `simple_leaf`.

    Returns
    -------
    device function
        ``walk(tree, ray, search, stack) -> search``, where `tree` has the address of the root,
        ``nodes``; 0 for an empty tree.
    """

    @device
    def walk(tree, ray, search, stack):
        link, top = DONE if tree.nodes == NULL else ROOT, stack
        while link != DONE:
            while link >= ROOT and link != DONE:
                at = tree.nodes + np.uint64(link) * _NODE
                left_box, left = _child(at)
                right_box, right = _child(at + _SECOND_CHILD)
                left_distance, enters_left = enter(left_box, ray, search)
                right_distance, enters_right = enter(right_box, ray, search)
                if enters_left and enters_right:
                    is_right_nearer = right_distance < left_distance
                    store(top, left if is_right_nearer else right)
                    top += ENTRY
                    link = right if is_right_nearer else left
                elif enters_left or enters_right:
                    link = left if enters_left else right
                else:
                    link, top = pop(stack, top)
            while link < ROOT:
                tree, ray, search, link, top = at_leaf(tree, ray, search, link, stack, top)
        return search

    return walk


@device
def _child(at):
    """The box of a child of a node, and its link."""
    sides = load_constant(f32x4, at)
    rest = load_constant(f32x4, at + _SECOND_ROW)
    box = lane(sides, 0), lane(sides, 1), lane(sides, 2), lane(sides, 3), lane(rest, 0)
    return (*box, lane(rest, 1)), lane(float_as_bits(rest), 2)


@device
def pop(stack, top):
    """Pop the latest link, or `DONE` from an empty stack."""
    if top == stack:
        return DONE, top
    top -= ENTRY
    return load(np.int32, top), top


def simple_leaf(search_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the `at_leaf` of a walk in one tree.

    Parameters
    ----------
    search_leaf : device function
        ``search_leaf(tree, link, ray, search) -> (search, is_over)`` offers what is in a leaf.
    """

    @device
    def at_leaf(tree, ray, search, link, stack, top):
        search, is_over = search_leaf(tree, link, ray, search)
        link, top = (DONE, top) if is_over else pop(stack, top)
        return tree, ray, search, link, top

    return at_leaf


@device
def _enter_box(box, ray, search):
    low_x, high_x, low_y, high_y, low_z, high_z = box
    t_in, t_out = box_interval(ray, low_x, low_y, low_z, high_x, high_y, high_z)
    return t_in, max(t_in, search.t_min) <= min(t_out, search.t_far)


def ray_traversal(at_leaf: Callable[..., Any]) -> Callable[..., Any]:
    """Make the traversal of a `Ray`; see `kernels.queries.ray_queries` for its arguments."""
    walk = binary_walk(_enter_box, at_leaf)

    @device
    def traverse(tree, ray, search, stack):
        # Written so that a NaN ends it.
        if search.t_min <= search.t_far:
            search = walk(tree, ray, search, stack)
        return search

    return traverse
