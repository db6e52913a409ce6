"""The kd-tree as shaders read it, with a file for each traversal and each layout."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.packing import FAR
from raystream.graphics.structures.base import ShaderStructure, budget_for, numbers
from raystream.structures.kdtree.foley_layout import LEAF_BIT
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.structure import KdTreeStructure

#: Files of each layout's nodes and their parents, and of each traversal.
_LAYOUTS = {"compact": "kdtree/compact.wgsl", "foley": "kdtree/foley.wgsl"}
_PARENTS = {"compact": "kdtree/compact_parents.wgsl", "foley": "kdtree/foley_parents.wgsl"}
_TRAVERSALS = {
    "stack": "kdtree/stack.wgsl",
    "restart": "kdtree/restart.wgsl",
    "backtrack": "kdtree/backtrack.wgsl",
    "short-stack": "kdtree/short_stack.wgsl",
}

#: Stack sizes are multiples of this, so that trees of similar depth share shaders.
_STACK_STEP = 8


def shader_structure(kdtree: KdTreeStructure) -> ShaderStructure:
    """Nodes and leaf blocks; for kd-backtrack, bounds and parents of the splits."""
    traversal, layout = kdtree.options.traversal, kdtree.options.layout
    low, high = kdtree.triangles.bounds
    nodes = kdtree.tree.nodes
    depth = _depth_of(nodes)
    is_leaf = layout == "foley" and len(nodes) == 1
    root = 1 << LEAF_BIT if is_leaf else 0
    return ShaderStructure(
        name="kdtree",
        shader="kdtree.wgsl",
        tree=numbers(*map(float, low), root, *map(float, high), len(nodes)),
        arrays=_arrays(kdtree),
        budget=budget_for(_most_steps(nodes, depth, len(kdtree.blocks))),
        instead={
            "kdtree/compact.wgsl": _LAYOUTS[layout],
            "kdtree/compact_parents.wgsl": _PARENTS[layout],
            "kdtree/stack.wgsl": _TRAVERSALS[traversal],
        },
        sizes={"STACK_SIZE": max(-(-depth // _STACK_STEP), 1) * _STACK_STEP},
    )


def _arrays(kdtree: KdTreeStructure) -> tuple[NDArray[Any], ...]:
    nodes: tuple[NDArray[Any], ...] = (kdtree.tree.nodes, kdtree.blocks)
    if kdtree.options.layout == "foley":
        packed = kdtree.packed
        splits, leaves = packed or (np.empty((0, 3), np.uint32),) * 2
        nodes = (splits, kdtree.blocks, leaves)
    if kdtree.options.traversal != "backtrack":
        return nodes
    if kdtree.extended is None:
        return (*nodes, np.empty((0, 8), np.float32))
    extended = kdtree.extended.copy()
    extended[:, :6] = np.clip(extended[:, :6], -FAR, FAR)
    return (*nodes, extended)


def _depth_of(nodes: NDArray[np.int32]) -> int:
    """Splits on the longest path."""
    rows = np.zeros(min(len(nodes), 1), np.int32)
    depth = -1
    while len(rows):
        depth += 1
        words = nodes[rows, 1]
        left = words[words & 3 != LEAF_AXIS] >> 2
        rows = np.concatenate([left, left + 1])
    return max(depth, 0)


def _most_steps(nodes: NDArray[np.int32], depth: int, block_count: int) -> int:
    """Upper bound of a ray's steps: down to each leaf and up again once."""
    leaf_count = (len(nodes) + 1) // 2
    return leaf_count * (2 * depth + 2) + block_count
