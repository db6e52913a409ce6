"""Bvh: the bounding volume hierarchy as a structure."""

from __future__ import annotations

import operator
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.threads import Progress
from raystream.kernels.queries import ray_queries
from raystream.structures.base import BuildReport, Structure
from raystream.structures.bvh.build import build_arrays, gather_corners
from raystream.structures.bvh.layout import STACK_SIZE, BvhArrays, check_arrays
from raystream.structures.bvh.traversal import traverse

__all__ = ["Bvh"]


class Bvh(Structure):
    """A binary bounding volume hierarchy.

    Parameters
    ----------
    triangles : Triangles
    max_leaf_size : int
        Most triangles in a leaf, 1 to 64.
    progress : callable, optional
        Called with (triangles placed, triangles) while building.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If it is no integer.
    """

    name = "bvh"
    queries = ray_queries(traverse, STACK_SIZE)

    def __init__(
        self, triangles: Triangles, *, max_leaf_size: int = 4, progress: Progress | None = None
    ) -> None:
        max_leaf_size = operator.index(max_leaf_size)
        if not 1 <= max_leaf_size <= 64:
            raise ValueError(f"max_leaf_size: expected 1 to 64, got {max_leaf_size}")
        started = time.perf_counter()
        self._set(triangles, build_arrays(triangles, max_leaf_size, progress), started)

    def _set(self, triangles: Triangles, arrays: BvhArrays, started: float) -> None:
        self.triangles = triangles
        self._arrays = arrays
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=sum(array.nbytes for array in arrays),
        )

    def quality(self) -> dict[str, float]:
        """Node counts, depth, and the expected cost of a random ray that meets the bounds."""
        return _quality(self._arrays)

    @property
    def arrays(self) -> BvhArrays:
        """Nodes, and triangles in leaf order."""
        return self._arrays

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The tree, and the order of the triangles; their corners follow from it."""
        tree = self._arrays
        return {"boxes": tree.boxes, "children": tree.children, "prim_ids": tree.prim_ids}

    @classmethod
    def from_arrays(cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]]) -> Bvh:
        """Make a BVH of saved arrays; see `Structure.from_arrays`."""
        started = time.perf_counter()
        boxes, children, prim_ids = check_arrays(arrays, triangles.prim_ids)
        tree = BvhArrays(boxes, children, gather_corners(triangles, prim_ids), prim_ids)
        structure = cls.__new__(cls)
        structure._set(triangles, tree, started)
        return structure


def _quality(arrays: BvhArrays) -> dict[str, float]:
    """Node counts, depth, and the expected cost of a random ray."""
    counts = arrays.children[:, :, 1]
    leaves = counts > 0
    depth, cost = _depth_and_cost(arrays.boxes, arrays.children) if len(counts) else (0, 0.0)
    return {
        "nodes": float(len(counts)),
        "leaves": float(leaves.sum()),
        "triangles per leaf": float(counts[leaves].mean()) if leaves.any() else 0.0,
        "depth": float(depth),
        "expected nodes and triangles per ray": float(cost),
    }


@kernel
def _depth_and_cost(boxes, children):
    """Nodes on the longest path; the surface area heuristic's cost of the whole tree."""
    depths = np.zeros(len(children), np.int32)
    root = np.empty((2, 3), np.float64)
    for axis in range(3):
        root[0, axis] = min(boxes[0, 0, 0, axis], boxes[0, 1, 0, axis])
        root[1, axis] = max(boxes[0, 0, 1, axis], boxes[0, 1, 1, axis])
    root_area = _half_area(root)
    deepest = 0
    cost = 1.0
    for node in range(len(children)):
        depths[node] += 1
        deepest = max(deepest, depths[node])
        for child in range(2):
            index, count = children[node, child, 0], children[node, child, 1]
            if count < 0:
                continue
            share = _half_area(boxes[node, child]) / root_area if root_area > 0.0 else 1.0
            cost += share * max(1, count)
            if count == 0:
                depths[index] = depths[node]
    return deepest, cost


@kernel
def _half_area(box):
    x = np.float64(box[1, 0]) - np.float64(box[0, 0])
    y = np.float64(box[1, 1]) - np.float64(box[0, 1])
    z = np.float64(box[1, 2]) - np.float64(box[0, 2])
    return x * y + y * z + z * x
