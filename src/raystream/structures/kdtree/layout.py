"""The arrays of a kd-tree, its figures, and the check that it is safe to traverse."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.kdtree.options import MAX_DEPTH
from raystream.structures.saved import are_listed, take

#: Most nodes of a tree: the number of a child has 29 bits.
MAX_NODES = 1 << 29

#: The axis of a leaf.
LEAF_AXIS = 3


class KdArrays(NamedTuple):
    """Nodes of 8 bytes, and leaves of blocks with 4 triangles each.

    Attributes
    ----------
    nodes : ndarray of shape (M, 2), int32
        Row 0 is the root; M is odd. A split: the position of its plane, as the bits of a
        float32, local frame; ``left << 2 | axis``, where `left` is the row of the child below
        the plane; the one above it has the next row. `left` is odd and greater than the
        split's own row. A leaf: its first block; ``triangle_count << 2 | 3``.
    prim_ids : ndarray of shape (B, 4), int32
        The triangles of the blocks; -1 in unused places.
    """

    nodes: NDArray[np.int32]
    prim_ids: NDArray[np.int32]


def default_depth(triangle_count: int) -> int:
    """Default maximum depth (Pharr and Humphreys 2004)."""
    return min(MAX_DEPTH, round(8 + 1.3 * math.log2(max(triangle_count, 1))))


class TreeFigures(NamedTuple):
    """The figures of a tree.

    Attributes
    ----------
    depth : int
        Splits on the longest path.
    leaf_count, empty_count : int
        Leaves, and those without triangles.
    reference_count : int
        Triangles of all leaves; one in several leaves counts several times.
    splits_per_ray, leaves_per_ray, tests_per_ray : float
        Expected for a random line through the bounds, whether or not it hits anything.
    """

    depth: int
    leaf_count: int
    empty_count: int
    reference_count: int
    splits_per_ray: float
    leaves_per_ray: float
    tests_per_ray: float


@device
def _half_area(cells, node):
    x = np.float64(cells[node, 3]) - cells[node, 0]
    y = np.float64(cells[node, 4]) - cells[node, 1]
    z = np.float64(cells[node, 5]) - cells[node, 2]
    return x * y + y * z + z * x


@kernel
def _measure(nodes, positions, cells, depths):
    """Visit the nodes of a valid tree; row 0 of `cells` is the scene's box."""
    deepest, leaf_count, empty_count, reference_count = 0, 0, 0, 0
    splits, leaves, tests = 0.0, 0.0, 0.0
    whole = _half_area(cells, 0)
    for node in range(len(nodes)):
        axis, number = nodes[node, 1] & 3, nodes[node, 1] >> 2
        area = _half_area(cells, node)
        deepest = max(deepest, depths[node])
        if axis == LEAF_AXIS:
            leaf_count += 1
            empty_count += number == 0
            reference_count += number
            leaves += area
            tests += area * number
            continue
        splits += area
        for side in range(2):
            child = number + side
            depths[child] = depths[node] + 1
            for k in range(6):
                cells[child, k] = cells[node, k]
            inside = min(max(positions[node, 0], cells[node, axis]), cells[node, axis + 3])
            cells[child, axis + 3 * (1 - side)] = inside
    return (
        (deepest, leaf_count, empty_count, reference_count),
        (splits / whole, leaves / whole, tests / whole),
    )


def measure(nodes: NDArray[np.int32], bounds: NDArray[np.float32]) -> TreeFigures:
    """Measure a tree of at least one node; `bounds` of shape (2, 3) is the scene's box."""
    cells = np.empty((len(nodes), 6), np.float32)
    cells[0] = bounds.ravel()
    depths = np.zeros(len(nodes), np.int32)
    counts, sums = _measure(nodes, nodes.view(np.float32), cells, depths)
    return TreeFigures(*counts, *sums)


# Error codes of `_check_tree`.
_BAD_CHILD, _BAD_PLANE, _BAD_LEAF, _BAD_ID, _MISSING = -1, -2, -3, -4, -5

_FAULTS = {
    _BAD_CHILD: "a node's child is out of range or has two parents",
    _BAD_PLANE: "the plane of a split is not finite",
    _BAD_LEAF: "a leaf is out of range",
    _BAD_ID: "a leaf lists an invalid triangle, or too few",
    _MISSING: "a triangle of the scene is in no leaf",
}


@kernel
def _check_tree(nodes, positions, prim_ids, depths, solid, wanted):
    """Depth of the tree, or a negative error code."""
    node_count, block_count = len(nodes), len(prim_ids)
    deepest = 0
    for node in range(node_count):
        # Parents come before their children, so a node not reached by now has none.
        if node > 0 and depths[node] == 0:
            return _BAD_CHILD
        axis, number = nodes[node, 1] & 3, np.int64(nodes[node, 1]) >> 2
        if axis == LEAF_AXIS:
            first = np.int64(nodes[node, 0])
            if number < 0 or first < 0:
                return _BAD_LEAF
            if first + (number + BLOCK_SIZE - 1) // BLOCK_SIZE > block_count:
                return _BAD_LEAF
            if not are_listed(prim_ids, first, number, solid, wanted):
                return _BAD_ID
            continue
        if not np.isfinite(positions[node, 0]):
            return _BAD_PLANE
        # A greater row than the parent's: no cycle. Not reached before: one parent.
        if number <= node or number + 1 >= node_count or number % 2 == 0 or depths[number] != 0:
            return _BAD_CHILD
        depths[number] = depths[number + 1] = depths[node] + 1
        deepest = max(deepest, depths[number])
    for row in range(len(wanted)):
        if wanted[row]:
            return _MISSING
    return deepest


def check_arrays(
    arrays: Mapping[str, NDArray[Any]], solid_ids: NDArray[np.int32], triangle_count: int
) -> KdArrays:
    """Check a tree from a file: that no traversal reads out of bounds or never ends.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``nodes`` and ``prim_ids``, see `KdArrays`.
    solid_ids : ndarray of shape (A,), int32
        The triangles that the tree must hold, and no others.
    triangle_count : int
        Of the scene.

    Returns
    -------
    KdArrays

    Raises
    ------
    ValueError
        If it is invalid.

    Notes
    -----
    The tree may still be wrong: cells may lack triangles. Every search in a tree that passes
    ends: see `traversal`.
    """
    nodes = take(arrays, "nodes", np.int32, (None, 2))
    prim_ids = take(arrays, "prim_ids", np.int32, (None, BLOCK_SIZE))
    # In all blocks, also those of no leaf: corners are looked up for each.
    if len(prim_ids) and (prim_ids.min() < -1 or prim_ids.max() >= triangle_count):
        raise ValueError(_FAULTS[_BAD_ID])
    if len(nodes) == 0:
        if len(solid_ids) or len(prim_ids):
            raise ValueError(_FAULTS[_MISSING])
        return KdArrays(nodes, prim_ids)
    if len(nodes) % 2 == 0 or len(nodes) > MAX_NODES:
        raise ValueError(f"a tree cannot have {len(nodes):,} nodes")
    solid = np.zeros(triangle_count, np.bool_)
    solid[solid_ids] = True
    depths = np.zeros(len(nodes), np.int32)
    positions = nodes.view(np.float32)
    depth = _check_tree(nodes, positions, prim_ids, depths, solid, solid.copy())
    if depth in _FAULTS:
        raise ValueError(_FAULTS[depth])
    if depth > MAX_DEPTH:
        raise ValueError(f"the tree is {depth} splits deep; at most {MAX_DEPTH} are possible")
    return KdArrays(nodes, prim_ids)
