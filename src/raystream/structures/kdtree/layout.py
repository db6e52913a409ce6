"""The arrays of a kd-tree, its figures, and the check that it is safe to traverse."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.kdtree.options import MAX_DEPTH
from raystream.structures.saved import check_blocks, take

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


def depth_limit(max_depth: int | None, triangle_count: int) -> int:
    """The option `max_depth`, or its default (Pharr and Humphreys 2004)."""
    if max_depth is not None:
        return max_depth
    return min(MAX_DEPTH, round(8 + 1.3 * math.log2(max(triangle_count, 1))))


@kernel
def find_cells(nodes, positions, boxes, depths):
    """Write the boxes and depths of the nodes of a tree, given those of the root in row 0.

    Parameters
    ----------
    nodes, positions : ndarray of shape (M, 2), int32 and float32
        The same memory; see `KdArrays`.
    boxes : ndarray of shape (M, 6), float32
        Low x, y, z, high x, y, z. A plane outside its box is moved to the box.
    depths : ndarray of shape (M,), int32
        Splits above a node.
    """
    for node in range(len(nodes)):  # parents come before their children
        axis, left = nodes[node, 1] & 3, nodes[node, 1] >> 2
        if axis == LEAF_AXIS:
            continue
        inside = min(max(positions[node, 0], boxes[node, axis]), boxes[node, axis + 3])
        for side in range(2):
            child = left + side
            depths[child] = depths[node] + 1
            for k in range(6):
                boxes[child, k] = boxes[node, k]
            boxes[child, axis + 3 * (1 - side)] = inside


def measure(nodes: NDArray[np.int32], bounds: NDArray[np.float32]) -> dict[str, float]:
    """Measure a tree.

    Parameters
    ----------
    nodes : ndarray of shape (M, 2), int32
        At least one; see `KdArrays`.
    bounds : ndarray of shape (2, 3), float32
        The scene's box.

    Returns
    -------
    dict of str to float
        See `KdTreeStructure.quality`.
    """
    boxes, depths = np.empty((len(nodes), 6), np.float32), np.zeros(len(nodes), np.int32)
    boxes[0] = bounds.ravel()
    find_cells(nodes, nodes.view(np.float32), boxes, depths)
    x, y, z = (boxes[:, 3:].astype(np.float64) - boxes[:, :3]).T
    areas = x * y + y * z + z * x
    is_leaf = nodes[:, 1] & 3 == LEAF_AXIS
    counts = np.where(is_leaf, nodes[:, 1] >> 2, 0)
    visits = np.stack([~is_leaf, is_leaf, counts], axis=1)
    with np.errstate(invalid="ignore"):  # nan where the scene has no area
        splits, leaves, tests = ((areas[:, None] * visits).sum(axis=0) / areas[0]).tolist()
    return {
        "nodes": float(len(nodes)),
        "leaves": float(np.count_nonzero(is_leaf)),
        "empty leaves": float(np.count_nonzero(is_leaf & (counts == 0))),
        "references": float(counts.sum(dtype=np.int64)),
        "depth": float(depths.max()),
        "splits per ray": splits,
        "leaves per ray": leaves,
        "tests per ray": tests,
    }


def check_arrays(arrays: Mapping[str, NDArray[Any]], solid: NDArray[np.bool_]) -> KdArrays:
    """Check a tree from a file: that no traversal reads out of bounds or never ends.

    Parameters
    ----------
    arrays : mapping of str to ndarray
        ``nodes`` and ``prim_ids``, see `KdArrays`.
    solid : ndarray of shape (F,), bool
        Whether the tree must hold a triangle of the scene.

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
    is_leaf = nodes[:, 1] & 3 == LEAF_AXIS
    if len(nodes):
        if len(nodes) % 2 == 0 or len(nodes) > MAX_NODES:
            raise ValueError(f"a tree cannot have {len(nodes):,} nodes")
        splits = np.flatnonzero(~is_leaf)
        left = nodes[splits, 1] >> 2
        # Greater rows than the parent's: no cycle. Each pair of children once: one parent.
        is_after = (left > splits).all()
        if not (is_after and np.array_equal(np.sort(left), np.arange(1, len(nodes), 2))):
            raise ValueError("a node's child is out of range or has two parents")
        positions = nodes.view(np.float32)
        if not np.isfinite(positions[splits, 0]).all():
            raise ValueError("the plane of a split is not finite")
        boxes, depths = np.zeros((len(nodes), 6), np.float32), np.zeros(len(nodes), np.int32)
        find_cells(nodes, positions, boxes, depths)
        if depths.max() > MAX_DEPTH:
            raise ValueError(
                f"the tree is {depths.max()} splits deep; at most {MAX_DEPTH} are possible"
            )
    check_blocks(prim_ids, nodes[is_leaf, 0], nodes[is_leaf, 1] >> 2, solid, "leaf")
    return KdArrays(nodes, prim_ids)
