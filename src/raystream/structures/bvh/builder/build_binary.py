"""Build the binary tree on all threads.

Large ranges of references are split one after another by all threads; medium ones by one thread
each; small ones become subtrees, each built by one thread. The limits depend on the number of
triangles only, so the tree is the same for any number of threads.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, chunk_size, parallel_for, part_of
from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.builder.binary_tree import LINK_INTS, BinaryTree, BuildSettings
from raystream.structures.bvh.builder.collapse import COST_FLOATS, collapse_top
from raystream.structures.bvh.builder.parallel_split import split_large
from raystream.structures.bvh.builder.prim_refs import REF_FLOATS, make_refs
from raystream.structures.bvh.builder.subtree import grow_subtree, split_once
from raystream.structures.bvh.builder.write_wide import READ_AHEAD

#: Ranges of more triangles are split by all threads together.
_LARGE = 1 << 17

#: Most triangles per call of a loop over all triangles.
_MOST = 1 << 16


class Tree(NamedTuple):
    """A finished binary tree, with the decisions about its collapse.

    Attributes
    ----------
    arrays : BinaryTree
    root : int
        Row of the root.
    top_count : int
        Nodes above the subtrees.
    """

    arrays: BinaryTree
    root: int
    top_count: int


@dataclass
class _Range:
    """A range of references, to be split or to become a subtree."""

    begin: int
    end: int
    depth: int
    bounds: NDArray[np.float32]
    refs: NDArray[np.float32]
    parts: tuple[_Range, _Range] | None = None
    row: int = 0

    @property
    def size(self) -> int:
        return self.end - self.begin

    @property
    def node(self) -> int:
        """Row of its root: between the rows of its parts, or its first row."""
        return 2 * self.parts[1].begin - 1 if self.parts else 2 * self.begin

    def split(
        self, middle: int, bounds: NDArray[np.float32], refs: NDArray[np.float32]
    ) -> tuple[_Range, _Range]:
        """Make the parts from the end of the left one."""
        depth = self.depth + 1
        self.parts = (
            _Range(self.begin, middle, depth, bounds[0], refs),
            _Range(middle, self.end, depth, bounds[1], refs),
        )
        return self.parts


def grow_tree(triangles: Triangles, settings: BuildSettings, progress: Progress | None) -> Tree:
    """Build a binary tree over the solid triangles, at least one.

    Parameters
    ----------
    triangles : Triangles
    settings : BuildSettings
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    Tree
    """
    return _Grower(triangles, settings).grow(progress)


class _Grower:
    def __init__(self, triangles: Triangles, settings: BuildSettings) -> None:
        self.triangles = triangles
        self.settings = settings
        self.count = count = len(triangles.prim_ids)
        # `write_trees` reads a few references past the last.
        self.refs = aligned_array(count + READ_AHEAD, REF_FLOATS)[:count]
        self.tree = BinaryTree(
            self.refs,
            np.empty((2 * count, REF_FLOATS), np.float32),
            np.empty((2 * count, LINK_INTS), np.int32),
        )
        # About 64 subtrees or more, of 1 to 10 ms each.
        self.subtree_size = min(max(1 << 12, self.count >> 6), 1 << 16)

    def grow(self, progress: Progress | None) -> Tree:
        root = self._make_refs()
        size = root.bounds[0, 4:7] + root.bounds[0, :3]
        area = np.float32(size[0] * size[1] + size[1] * size[2] + size[2] * size[0])
        node_cost, block_cost, price = self.settings.costs
        self.settings = self.settings._replace(costs=(node_cost, block_cost, price * area))
        ranges = [root]  # parts come after the whole
        self._split_middle(self._split_large(ranges), ranges)
        for row, part in enumerate(ranges):
            part.row = row
        costs = np.empty((len(ranges), COST_FLOATS), np.float32)
        self._grow_subtrees([part for part in ranges if part.parts is None], costs, progress)
        if len(ranges) > 1:
            self._collapse_top(ranges, costs)
        top_count = sum(part.parts is not None for part in ranges)
        return Tree(self.tree, root.node, top_count)

    def _collapse_top(self, ranges: list[_Range], costs: NDArray[np.float32]) -> None:
        collapse_top(
            np.array([[p.row for p in part.parts or ()] or [-1, -1] for part in ranges], np.int32),
            np.array([part.node for part in ranges], np.int32),
            np.array([[part.begin, part.end] for part in ranges], np.int32),
            np.array([part.bounds[0] for part in ranges]),
            costs,
            self.tree,
            self.settings,
        )

    def _make_refs(self) -> _Range:
        corners, prim_ids = self.triangles.corners, self.triangles.prim_ids
        chunk = chunk_size(self.count, _MOST)
        bounds = np.full((-(-self.count // chunk), 2, 8), -np.inf, np.float32)

        def body(begin: int, end: int) -> None:
            make_refs(begin, end, corners, prim_ids, self.refs, bounds[begin // chunk])

        parallel_for(body, self.count, chunk)
        return _Range(0, self.count, 0, bounds.max(axis=0), self.refs)

    def _split_large(self, ranges: list[_Range]) -> list[_Range]:
        """Split the large ranges; append their parts to `ranges`, return the others."""
        (root,) = ranges
        if root.size <= _LARGE:
            return [root]
        # References move between two arrays at each split.
        other = aligned_array(len(self.refs), REF_FLOATS)
        pending, others = [root], []
        while pending:
            part = pending.pop()
            result = None
            target = other if part.refs is self.refs else self.refs
            if part.size > _LARGE and part.depth < self.settings.sah_depth:
                result = split_large(part.refs, target, part.begin, part.end, part.bounds[1])
            if result is None:
                others.append(part)
                continue
            middle, bounds = result
            parts = part.split(middle, bounds, target)
            ranges += parts
            pending += parts
        return others

    def _split_middle(self, level: list[_Range], ranges: list[_Range]) -> None:
        """Split ranges until all are small, one thread each; append the parts to `ranges`."""
        while level := [part for part in level if part.size > self.subtree_size]:

            def body(begin: int, end: int, level: list[_Range] = level) -> None:
                for part in level[begin:end] or [self._nothing()]:
                    bounds = np.empty((2, 2, REF_FLOATS), np.float32)
                    use_sides = part.depth < self.settings.sah_depth
                    span = part.begin, part.end
                    middle = split_once(part.refs, *span, use_sides, part.bounds, bounds)
                    part.split(int(middle), bounds, part.refs)

            parallel_for(body, len(level), 1)
            level = [part for whole in level for part in whole.parts or ()]
            ranges += level

    def _nothing(self) -> _Range:
        """An empty range, for calls that only compile."""
        return _Range(0, 0, 0, np.zeros((2, 8), np.float32), self.refs)

    def _grow_subtrees(
        self, subtrees: list[_Range], costs: NDArray[np.float32], progress: Progress | None
    ) -> None:
        # Largest first, so that the threads finish together.
        subtrees.sort(key=lambda part: -part.size)
        most_nodes = 2 * max(part.size for part in subtrees)
        free: list[NDArray[np.float32]] = []  # scratch, one for each thread

        def grow(part: _Range, scratch: NDArray[np.float32]) -> None:
            if part.refs is not self.refs:
                self.refs[part.begin : part.end] = part.refs[part.begin : part.end]
            where = self.tree, part.begin, part.end, part.depth, part.bounds
            grow_subtree(*where, self.settings, scratch, costs[part.row])

        def body(begin: int, end: int) -> None:
            try:
                scratch = free.pop()
            except IndexError:
                scratch = np.empty((most_nodes, COST_FLOATS), np.float32)
            for part in subtrees[begin:end] or [self._nothing()]:
                grow(part, scratch)
            free.append(scratch)

        whole = self.count
        parallel_for(body, len(subtrees), 1, part_of(progress, 0, whole, whole))
