"""Statistics of a tree: its size, and its quality by the surface area heuristic."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.kernels.leaf_block import BLOCK_SIZE
from raystream.structures.bvh.layout import WIDTH, BvhArrays


def statistics(arrays: BvhArrays) -> dict[str, float]:
    """Counts, depth, and the expected cost of a random ray that hits the bounds.

    Parameters
    ----------
    arrays : BvhArrays

    Returns
    -------
    dict of str to float
        ``nodes``, ``leaf blocks``; ``lane fill``: children in a node, of 8; ``block fill``:
        triangles in a block, of 4; ``depth``: nodes on the longest path; ``references``:
        triangles in all leaves, with multiplicity; ``nodes per ray`` and ``blocks per ray``:
        expected numbers on a random line through the bounds, whatever it hits (nan for a scene
        without area).
    """
    nodes, leaves = arrays
    if len(nodes) == 0:
        depth, child_count, node_steps, block_tests = 0, 0, 0.0, 0.0
    else:
        depth, child_count, node_steps, block_tests = _measure(nodes, arrays.children)
    references = int(np.count_nonzero(arrays.prim_ids >= 0))
    return {
        "nodes": float(len(nodes)),
        "leaf blocks": float(len(leaves)),
        "lane fill": child_count / max(1, WIDTH * len(nodes)),
        "block fill": references / max(1, BLOCK_SIZE * len(leaves)),
        "depth": float(depth),
        "references": float(references),
        "nodes per ray": node_steps,
        "blocks per ray": block_tests,
    }


@device
def _extent(nodes, node, first, last, axis):
    """Length of the box around the children from first to last, along an axis; float64."""
    low, high = np.float32(np.inf), np.float32(-np.inf)
    for lane in range(first, last):
        low = min(low, nodes[node, axis * 2 * WIDTH + lane])
        high = max(high, nodes[node, (axis * 2 + 1) * WIDTH + lane])
    return np.float64(high) - np.float64(low)


@device
def _half_area(nodes, node, first, last):
    x = _extent(nodes, node, first, last, 0)
    y = _extent(nodes, node, first, last, 1)
    z = _extent(nodes, node, first, last, 2)
    return x * y + y * z + z * x


@kernel
def _measure(nodes, children):
    """Depth, number of children, and sums of areas over the root's area."""
    depths = np.zeros(len(nodes), np.int32)
    whole = _half_area(nodes, 0, 0, WIDTH)
    deepest, child_count = 0, 0
    node_area, block_area = whole, 0.0
    for node in range(len(nodes)):
        depth = depths[node] + 1
        deepest = max(deepest, depth)
        for lane in range(WIDTH):
            child = np.int64(children[node, lane])
            if child == 0:
                continue
            child_count += 1
            area = _half_area(nodes, node, lane, lane + 1)
            if child > 0:
                depths[child] = depth
                node_area += area
            else:
                block_area += area * ((~child & 7) + 1)
    return deepest, child_count, node_area / whole, block_area / whole
