"""Build the BVH on all threads: a binary tree, which is collapsed and written as a wide one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for
from raystream.kernels.aligned import aligned_array
from raystream.kernels.leaf_block import BLOCK_FLOATS
from raystream.structures.bvh.builder.binary_tree import (
    HALVING_LEVELS,
    MAX_TREE_DEPTH,
    BuildSettings,
)
from raystream.structures.bvh.builder.build_binary import Tree, grow_tree
from raystream.structures.bvh.builder.write_wide import Deferred, WideTrees, write_trees
from raystream.structures.bvh.layout import MAX_BLOCKS, MAX_DEPTH, NODE_FLOATS, WIDTH, BvhArrays

#: `min_split_size` and `plain_size` of `BuildSettings`.
QUALITIES = {"fast": (4, 1024), "balanced": (2, 0)}

#: Relative times of a node step and of a block test, and the price of a block: it must save this
#: many tests per ray that meets the scene. (Without it, a forest has a third more blocks.)
_COSTS = (np.float32(1.0), np.float32(1.0), np.float32(1e-5))

#: Wide trees per call of `write_trees`.
_TREES_PER_CALL = 4


def build_arrays(
    triangles: Triangles,
    quality: str = "balanced",
    max_leaf_size: int = 4,
    progress: Progress | None = None,
) -> BvhArrays:
    """Build an 8-wide BVH.

    Parameters
    ----------
    triangles : Triangles
    quality : {"fast", "balanced"}
    max_leaf_size : int
        Most triangles in a leaf, 1 to 32.
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    BvhArrays
        The same for any number of threads.

    Raises
    ------
    ValueError
        If the tree would be too large for the layout: beyond about 500 million triangles.

    References
    ----------
    Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", IEEE Symposium
    on Interactive Ray Tracing 2007.
    """
    if len(triangles.prim_ids) == 0:
        return _make_arrays(0, 0)
    small, plain_size = QUALITIES[quality]
    # Paths have far fewer wide nodes than binary ones, but that is not guaranteed: if the wide
    # tree is too deep, build a binary tree within the limit.
    for tree_depth in (MAX_TREE_DEPTH, MAX_DEPTH):
        settings = BuildSettings(
            min_split_size=min(small, max_leaf_size),
            plain_size=plain_size,
            max_leaf_size=max_leaf_size,
            sah_depth=tree_depth - HALVING_LEVELS,
            costs=_COSTS,
        )
        tree = grow_tree(triangles, settings, progress)
        writer = _Writer(tree, triangles.corners)
        if writer.depth <= MAX_DEPTH:
            break
    return writer.write()


def _make_arrays(node_count: int, block_count: int) -> BvhArrays:
    return BvhArrays(
        aligned_array(node_count, NODE_FLOATS), aligned_array(block_count, BLOCK_FLOATS)
    )


def triangles_of_boxes(
    boxes: NDArray[np.float64],
    is_held: NDArray[np.bool_],
    center: NDArray[np.float64],
    scale: float,
) -> Triangles:
    """Triangles that span boxes, for a tree over these.

    A triangle with two of its vertices at a box's low and high corner has that box.

    Parameters
    ----------
    boxes : ndarray of shape (N, 2, 3), float64
        Low and high corners, in the local frame of `center` and `scale`.
    is_held : ndarray of shape (N,), bool
        Which of them the tree has.
    center : ndarray of shape (3,), float64
    scale : float
    """
    corners = np.empty((len(boxes), 3, 3), np.float32)
    corners[:, 0] = np.nextafter(boxes[:, 0].astype(np.float32), np.float32(-np.inf))
    corners[:, 1] = np.nextafter(boxes[:, 1].astype(np.float32), np.float32(np.inf))
    corners[:, 2] = corners[:, 0]
    bounds = np.zeros((2, 3), np.float32)
    if is_held.any():
        # By axis: NumPy finds the extremes of long rows fast.
        low, high = np.ascontiguousarray(corners[is_held, :2].transpose(1, 2, 0))
        bounds[:] = low.min(axis=1), high.max(axis=1)
    splits = np.array([0, len(boxes)], np.int64)
    return Triangles.from_solid(corners, splits, center, scale, is_held, 0, bounds)


class _Writer:
    """Count the rows of a wide tree, then write them.

    First the top of the tree, then the subtrees below it in parallel.
    """

    def __init__(self, tree: Tree, corners: NDArray[np.float32]) -> None:
        self.tree = tree
        self.corners = corners
        self.top = WideTrees.of(np.array([tree.root], np.int32), np.zeros(1, np.int32))
        self.deferred = Deferred.of(WIDTH * tree.top_count)
        self._emit(self.top, self.deferred, None)
        found = int(self.top.counts[0, 3])
        self.below = WideTrees.of(self.deferred.nodes[:found], self.deferred.depths[:found])
        self._emit(self.below, Deferred.of(0), None)
        counts = np.concatenate([self.top.counts, self.below.counts])
        self.depth = int(counts[:, 2].max())
        ends = np.cumsum(counts, axis=0)
        self.below.first_nodes[:] = self.deferred.rows[:found] = ends[:-1, 0]
        self.below.first_blocks[:] = ends[:-1, 1]
        self.node_count, self.block_count = int(ends[-1, 0]), int(ends[-1, 1])

    def write(self) -> BvhArrays:
        if self.block_count > MAX_BLOCKS:
            raise ValueError(f"{self.block_count:,} leaf blocks are more than {MAX_BLOCKS:,}")
        arrays = _make_arrays(self.node_count, self.block_count)
        self._emit(self.top, self.deferred, arrays)
        self._emit(self.below, Deferred.of(0), arrays)
        return arrays

    def _emit(self, trees: WideTrees, deferred: Deferred, arrays: BvhArrays | None) -> None:
        """Count, or write to `arrays` if given."""
        wide = _make_arrays(0, 0) if arrays is None else arrays

        def body(begin: int, end: int) -> None:
            read = self.tree.arrays, self.corners
            write_trees(begin, end, trees, deferred, arrays is not None, *read, wide)

        parallel_for(body, len(trees.roots), _TREES_PER_CALL)
