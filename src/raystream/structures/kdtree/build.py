"""Building the kd-tree on all threads.

The top of the tree is split level by level, each cell by one thread; smaller cells become subtrees,
each built by one thread. Their size depends on the number of triangles alone, so the tree
is the same for any number of threads.

References
----------
Wald and Havran, "On building fast kd-Trees for Ray Tracing, and on doing that in O(N log N)",
IEEE Symposium on Interactive Ray Tracing 2006.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for, part_of
from raystream.structures.clip import BOUND
from raystream.structures.kdtree.layout import LEAF_AXIS, MAX_NODES, KdArrays
from raystream.structures.kdtree.subtree import (
    BuildSettings,
    Cell,
    GrownTriangles,
    References,
    grow_subtree,
    make_references,
    place_subtree,
    split_range,
)

#: Most references in all leaves together, per triangle; and references that are always allowed.
MAX_REFERENCES = 12
LEAST_ROOM = 1 << 10

#: Triangles per call of a loop over all triangles.
_CHUNK = 1 << 16


def root_box(triangles: Triangles) -> NDArray[np.float32]:
    """The box of all references, shape (2, 3): the scene's, grown by `clip.BOUND`."""
    bound = np.float32(float(triangles.max_coordinate) * BOUND)
    return np.stack([triangles.bounds[0] - bound, triangles.bounds[1] + bound])


def subtree_size(triangle_count: int) -> int:
    """Most references of a cell whose subtree one thread builds."""
    # At least about 64 subtrees, of 10 to 100 ms each.
    return max(1 << 12, triangle_count >> 6)


class _TopNode:
    """A node of the top of the tree: split in two, or the root of a subtree."""

    def __init__(self, boxes: NDArray[np.float32], ids: NDArray[np.int32], cell: Cell) -> None:
        self.boxes, self.ids, self.cell = boxes, ids, cell
        self.axis = LEAF_AXIS
        self.position = np.float32(0.0)
        self.children: tuple[_TopNode, _TopNode] | None = None  # below and above the plane
        self.slot = 0
        self.subtree = KdArrays(np.zeros((0, 2), np.int32), np.zeros((0, 4), np.int32))

    @property
    def size(self) -> int:
        return len(self.ids)

    def working_copy(self, row_count: int) -> References:
        """Copy the references, with free rows after them."""
        boxes = np.empty((row_count, 6), np.float32)
        ids = np.empty(row_count, np.int32)
        boxes[: self.size], ids[: self.size] = self.boxes, self.ids
        return References(boxes, ids, self.size)

    def free_references(self) -> None:
        self.boxes, self.ids = self.boxes[:0], self.ids[:0]


def build_arrays(
    triangles: Triangles, settings: BuildSettings, progress: Progress | None = None
) -> KdArrays:
    """Build a kd-tree.

    Parameters
    ----------
    triangles : Triangles
    settings : BuildSettings
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    KdArrays
        The same for any number of threads.

    Raises
    ------
    ValueError
        If the tree would be too large for the layout: beyond 500 million nodes.

    Notes
    -----
    Memory is bounded: leaves hold at most `MAX_REFERENCES` references per triangle.
    Each cell has its share of that; one that has used it up becomes a leaf.
    """
    if len(triangles.prim_ids) == 0:
        return KdArrays(np.zeros((0, 2), np.int32), np.zeros((0, 4), np.int32))
    return _Builder(triangles, settings).build(progress)


class _Builder:
    def __init__(self, triangles: Triangles, settings: BuildSettings) -> None:
        self.prim_ids = triangles.prim_ids
        self.settings = settings
        bound = float(triangles.max_coordinate) * BOUND
        self.triangles = GrownTriangles(triangles.corners, bound, settings.overlap)
        self.subtree_size = subtree_size(len(self.prim_ids))

    def build(self, progress: Progress | None) -> KdArrays:
        top = self._grow_top(self._make_root())
        subtrees = [node for node in top if node.children is None]
        self._grow_subtrees(subtrees, progress)
        return self._join(top, subtrees)

    def _make_root(self) -> _TopNode:
        count = len(self.prim_ids)
        boxes = np.empty((count, 6), np.float32)
        bounds = np.full((-(-count // _CHUNK), 6), np.inf, np.float32)
        bounds[:, 3:] = -np.inf

        def body(begin: int, end: int) -> None:
            row = bounds[begin // _CHUNK]
            corners, bound = self.triangles.corners, np.float32(self.triangles.bound)
            make_references(begin, end, corners, self.prim_ids, bound, boxes, row)

        parallel_for(body, count, _CHUNK)
        box = np.concatenate([bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)])
        room = MAX_REFERENCES * count + LEAST_ROOM
        return _TopNode(boxes, self.prim_ids, Cell(box, 0, 0, room))

    def _grow_top(self, root: _TopNode) -> list[_TopNode]:
        """Split large cells; returns all nodes, parents before their children."""
        nodes = level = [root]
        while True:
            large = [
                node
                for node in level
                if node.size > self.subtree_size and node.cell.depth < self.settings.max_depth
            ]
            if not large:
                return nodes

            def body(begin: int, end: int, large: list[_TopNode] = large) -> None:
                for node in large[begin:end] or [_empty_node()]:
                    self._split(node)

            parallel_for(body, len(large), 1)
            level = [child for node in large for child in node.children or ()]
            nodes = nodes + level

    def _split(self, node: _TopNode) -> None:
        count, cell = node.size, node.cell
        references = node.working_copy(3 * count)
        result = np.zeros(4, np.int64)
        position = split_range(references, cell, self.triangles, self.settings.costs, result)
        axis, bad_splits, above_end, below_end = result.tolist()
        if count == 0 or axis == LEAF_AXIS:
            return
        box_below, box_above = cell.box.copy(), cell.box.copy()
        box_below[axis + 3] = box_above[axis] = position
        below_count = below_end - count
        room = cell.room * above_end // max(above_end + below_count, 1)
        room = min(max(room, above_end), cell.room - below_count)
        node.axis, node.position = axis, position

        def child(rows: slice, box: NDArray[np.float32], room: int) -> _TopNode:
            boxes, ids = references.boxes[rows].copy(), references.ids[rows].copy()
            return _TopNode(boxes, ids, Cell(box, cell.depth + 1, bad_splits, room))

        node.children = (
            child(slice(count, below_end), box_below, cell.room - room),
            child(slice(0, above_end), box_above, room),
        )
        node.free_references()

    def _grow_subtrees(self, subtrees: list[_TopNode], progress: Progress | None) -> None:
        # Large ones first, so that all threads finish together.
        ordered = sorted(subtrees, key=lambda node: -node.size)
        count = len(self.prim_ids)

        def body(begin: int, end: int) -> None:
            for node in ordered[begin:end] or [_empty_node()]:
                self._grow(node)

        parallel_for(body, len(ordered), 1, part_of(progress, 0, count, count))

    def _grow(self, node: _TopNode) -> None:
        room = max(node.cell.room, node.size)
        nodes = np.empty((4 * room + 1, 2), np.int32)
        tree = KdArrays(nodes, np.empty((room // 4 + len(nodes) // 2 + 2, 4), np.int32))
        result = np.zeros(2, np.int64)
        grow_subtree(
            node.working_copy(2 * room + node.size),
            node.cell._replace(room=room),
            self.triangles,
            self.settings,
            tree,
            result,
        )
        node_count, block_count = result.tolist()
        if node.size == 0:  # an empty leaf
            nodes[0] = 0, LEAF_AXIS
            node_count = 1
        node.subtree = KdArrays(nodes[:node_count].copy(), tree.prim_ids[:block_count].copy())
        node.free_references()

    def _join(self, top: list[_TopNode], subtrees: list[_TopNode]) -> KdArrays:
        """Join the top and the subtrees into one tree."""
        end = 1
        for node in top:
            if node.children:
                for side, child in enumerate(node.children):
                    child.slot = end + side
                end += 2
        node_counts = np.array([len(node.subtree.nodes) - 1 for node in subtrees])
        block_counts = np.array([len(node.subtree.prim_ids) for node in subtrees])
        bases = end + np.cumsum(node_counts) - node_counts
        first_blocks = np.cumsum(block_counts) - block_counts
        node_total = end + int(node_counts.sum())
        if node_total > MAX_NODES:
            raise ValueError(f"{node_total:,} nodes are more than {MAX_NODES:,}")
        tree = KdArrays(
            np.empty((node_total, 2), np.int32),
            np.empty((int(block_counts.sum()), 4), np.int32),
        )
        for node in top:
            if node.children:
                position = np.array([node.position], np.float32).view(np.int32)[0]
                tree.nodes[node.slot] = position, node.children[0].slot << 2 | node.axis
        for node, base, first in zip(subtrees, bases.tolist(), first_blocks.tolist(), strict=True):
            nodes, prim_ids = node.subtree
            place_subtree(0, len(nodes), nodes, node.slot, base, first, tree.nodes)
            tree.prim_ids[first : first + len(prim_ids)] = prim_ids
        return tree


def _empty_node() -> _TopNode:
    """A node for calls that only compile."""
    cell = Cell(np.zeros(6, np.float32), 0, 0, 0)
    return _TopNode(np.zeros((0, 6), np.float32), np.zeros(0, np.int32), cell)
