"""The arrays of a binary BVH, and the check that they are safe to traverse."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel

__all__ = ["MAX_DEPTH", "STACK_SIZE", "BvhArrays", "check_arrays"]

#: Nodes on the longest path that the builder makes and the traversal can take.
MAX_DEPTH = 112

#: Each node on a path leaves at most one entry on the stack, and the last one two.
STACK_SIZE = MAX_DEPTH + 1


class BvhArrays(NamedTuple):
    """Inner nodes that hold their two children's boxes, and triangles in leaf order.

    Attributes
    ----------
    boxes : ndarray of shape (M, 2, 2, 3), float32
        boxes[node, child] is the (low, high) corners of that child, local frame.
    children : ndarray of shape (M, 2, 2), int32
        children[node, child] is (index, count). With a count of 0 the child is the inner
        node `index`, which is greater than `node`; else it is a leaf, whose triangles are
        rows index to index + count of `corners`. An absent child has count -1 and an
        empty box (low = inf, high = -inf), which no ray enters.
    corners : ndarray of shape (A, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
    """

    boxes: NDArray[np.float32]
    children: NDArray[np.int32]
    corners: NDArray[np.float32]
    prim_ids: NDArray[np.int32]


@kernel
def _check_children(children, triangle_count, depths, covered):
    """Depth of the tree, or -1 if it is none, -2 if its leaves do not hold each row once."""
    node_count = len(children)
    deepest = 0
    for node in range(node_count):
        # Parents come before their children, so a node not reached by now never is.
        if node > 0 and depths[node] == 0:
            return -1
        depth = depths[node] + 1
        deepest = max(deepest, depth)
        for child in range(2):
            index, count = children[node, child, 0], children[node, child, 1]
            if count == 0:
                # A greater index than the parent's: no cycle. Not seen yet: one parent.
                if index <= node or index >= node_count or depths[index] != 0:
                    return -1
                depths[index] = depth
            elif count > 0:
                if index < 0 or index > triangle_count - count:
                    return -2
                for row in range(index, index + count):
                    if covered[row]:
                        return -2
                    covered[row] = True
    for row in range(triangle_count):
        if not covered[row]:
            return -2
    return deepest


def check_arrays(
    arrays: Mapping[str, NDArray[Any]], solid_ids: NDArray[np.int32]
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]]:
    """Check a tree from a file: no traversal of it may read out of bounds or not end.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``boxes``, ``children`` and ``prim_ids``, see `BvhArrays`.
    solid_ids : ndarray of shape (A,), int32
        The triangles that the tree must hold, each once, in increasing order.

    Returns
    -------
    boxes, children, prim_ids : ndarray

    Raises
    ------
    ValueError
        What is wrong.
    """
    boxes = _array(arrays, "boxes", np.float32, (2, 2, 3))
    children = _array(arrays, "children", np.int32, (2, 2))
    prim_ids = _array(arrays, "prim_ids", np.int32, ())
    if len(boxes) != len(children):
        raise ValueError("arrays disagree about the number of nodes")
    if not np.array_equal(np.sort(prim_ids), solid_ids):
        raise ValueError("its triangles are not those of the scene")
    absent = boxes[children[:, :, 1] < 0]
    if not ((absent[:, 0] == np.inf).all() and (absent[:, 1] == -np.inf).all()):
        raise ValueError("an absent child has a box")
    depths, covered = np.zeros(len(children), np.int32), np.zeros(len(prim_ids), np.bool_)
    depth = _check_children(children, len(prim_ids), depths, covered)
    if depth == -1:
        raise ValueError("a node's child is out of range or has two parents")
    if depth == -2:
        raise ValueError("its leaves do not hold every triangle once")
    if depth > MAX_DEPTH:
        raise ValueError(f"the tree is {depth} nodes deep; at most {MAX_DEPTH} are possible")
    return boxes, children, prim_ids


def _array(
    arrays: Mapping[str, NDArray[Any]], name: str, dtype: type, row_shape: tuple[int, ...]
) -> NDArray[Any]:
    if name not in arrays:
        raise ValueError(f"array {name!r} is missing")
    array = arrays[name]
    if array.dtype != dtype or array.ndim == 0 or array.shape[1:] != row_shape:
        raise ValueError(f"array {name!r} has dtype {array.dtype} and shape {array.shape}")
    return np.ascontiguousarray(array)
