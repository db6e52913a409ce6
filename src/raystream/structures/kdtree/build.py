"""Building the kd-tree on all threads.

The top of the tree is grown level by level, each cell by one thread; cells of few references
become subtrees, each built to the end by one thread. What is few depends on the number of
triangles alone, so the tree is the same for any number of threads.

References
----------
Wald and Havran, "On building fast kd-Trees for Ray Tracing, and on doing that in O(N log N)",
IEEE Symposium on Interactive Ray Tracing 2006.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for
from raystream.structures.clip import BOUND
from raystream.structures.kdtree.layout import LEAF_AXIS, MAX_NODES, KdArrays
from raystream.structures.kdtree.options import MAX_DEPTH
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.subtree import (
    grow_subtree,
    make_references,
    place_subtree,
    split_range,
)

__all__ = ["LEAST_ROOM", "MAX_REFERENCES", "Method", "build_arrays", "root_box", "subtree_size"]

#: References in all leaves together, for each triangle, at most; and for any scene.
MAX_REFERENCES = 12
LEAST_ROOM = 1 << 10

#: Triangles that one call of a loop over all triangles gets.
_CHUNK = 1 << 16


class Method(NamedTuple):
    """How to grow a tree.

    Attributes
    ----------
    costs : Costs
    max_depth : int
        Splits on a path.
    max_leaf_size : int
        Cells of so many references are not split.
    """

    costs: Costs
    max_depth: int
    max_leaf_size: int


def root_box(triangles: Triangles) -> NDArray[np.float32]:
    """The box of all references, shape (2, 3): the scene's, grown by `clip.BOUND`."""
    bound = np.float32(float(triangles.max_coordinate) * BOUND)
    return np.stack([triangles.bounds[0] - bound, triangles.bounds[1] + bound])


def subtree_size(triangle_count: int) -> int:
    """References of the largest cells that one thread builds the subtree of."""
    # About 64 subtrees or more, of 10 to 100 ms each.
    return max(1 << 12, triangle_count >> 6)


class _Cell:
    """A cell of the top of the tree: split in two, or the root of a subtree."""

    def __init__(
        self,
        boxes: NDArray[np.float32],
        ids: NDArray[np.int32],
        box: NDArray[np.float32],
        depth: int,
        bad_splits: int,
        room: int,
    ) -> None:
        self.boxes, self.ids, self.box = boxes, ids, box
        self.depth, self.bad_splits, self.room = depth, bad_splits, room
        self.axis = LEAF_AXIS
        self.position = np.float32(0.0)
        self.parts: tuple[_Cell, _Cell] | None = None  # below and above the plane
        self.slot = 0
        self.nodes = np.zeros((0, 2), np.int32)
        self.prim_ids = np.zeros((0, 4), np.int32)

    @property
    def size(self) -> int:
        return len(self.ids)

    def working_copy(self, row_count: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """The references, with free rows behind them."""
        boxes = np.empty((row_count, 6), np.float32)
        ids = np.empty(row_count, np.int32)
        boxes[: self.size], ids[: self.size] = self.boxes, self.ids
        return boxes, ids

    def forget_references(self) -> None:
        self.boxes, self.ids = self.boxes[:0], self.ids[:0]


def build_arrays(
    triangles: Triangles, method: Method, progress: Progress | None = None
) -> KdArrays:
    """Build a kd-tree.

    Parameters
    ----------
    triangles : Triangles
    method : Method
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    KdArrays
        The same ones for any number of threads.

    Raises
    ------
    ValueError
        If the tree would be too large for the layout: beyond 500 million nodes.

    Notes
    -----
    Memory is bounded: leaves hold at most `MAX_REFERENCES` references for each triangle.
    Each cell has its share of that; one that has used it up is a leaf.
    """
    if len(triangles.prim_ids) == 0:
        return KdArrays(np.zeros((0, 2), np.int32), np.zeros((0, 4), np.int32))
    return _Builder(triangles, method).build(progress)


class _Builder:
    def __init__(self, triangles: Triangles, method: Method) -> None:
        self.corners = triangles.corners
        self.prim_ids = triangles.prim_ids
        self.method = method
        self.bound = float(triangles.max_coordinate) * BOUND
        self.subtree_size = subtree_size(len(self.prim_ids))

    def build(self, progress: Progress | None) -> KdArrays:
        cells = self._grow_top(self._make_root())
        subtrees = [cell for cell in cells if cell.parts is None]
        self._grow_subtrees(subtrees, progress)
        return self._join(cells, subtrees)

    def _make_root(self) -> _Cell:
        count = len(self.prim_ids)
        boxes = np.empty((count, 6), np.float32)
        bounds = np.full((-(-count // _CHUNK), 6), np.inf, np.float32)
        bounds[:, 3:] = -np.inf

        def body(begin: int, end: int) -> None:
            row = bounds[begin // _CHUNK]
            bound = np.float32(self.bound)
            make_references(begin, end, self.corners, self.prim_ids, bound, boxes, row)

        parallel_for(body, count, _CHUNK)
        box = np.concatenate([bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)])
        room = MAX_REFERENCES * count + LEAST_ROOM
        return _Cell(boxes, self.prim_ids, box, 0, 0, room)

    def _grow_top(self, root: _Cell) -> list[_Cell]:
        """Split large cells; returns all, parents before their parts."""
        cells = level = [root]
        while True:
            large = [
                cell
                for cell in level
                if cell.size > self.subtree_size and cell.depth < self.method.max_depth
            ]
            if not large:
                return cells

            def body(begin: int, end: int, large: list[_Cell] = large) -> None:
                for cell in large[begin:end] or [self._nothing()]:
                    self._split(cell)

            parallel_for(body, len(large), 1)
            level = [part for cell in large for part in cell.parts or ()]
            cells = cells + level

    def _nothing(self) -> _Cell:
        """A cell for calls that only compile."""
        box = np.zeros(6, np.float32)
        return _Cell(np.zeros((0, 6), np.float32), np.zeros(0, np.int32), box, 0, 0, 0)

    def _split(self, cell: _Cell) -> None:
        count = cell.size
        boxes, ids = cell.working_copy(3 * count)
        result = np.zeros(4, np.int64)
        position = split_range(
            boxes,
            ids,
            count,
            cell.box,
            cell.bad_splits,
            cell.room,
            self.corners,
            self.bound,
            self.method.costs,
            result,
        )
        axis, bad_splits, above_end, below_end = result.tolist()
        if count == 0 or axis == LEAF_AXIS:
            return
        box_below, box_above = cell.box.copy(), cell.box.copy()
        box_below[axis + 3] = box_above[axis] = position
        below_count = below_end - count
        room_above = cell.room * above_end // max(above_end + below_count, 1)
        room_above = min(max(room_above, above_end), cell.room - below_count)
        below, above = slice(count, below_end), slice(0, above_end)
        depth = cell.depth + 1
        cell.axis, cell.position = axis, position
        cell.parts = (
            _Cell(
                boxes[below].copy(),
                ids[below].copy(),
                box_below,
                depth,
                bad_splits,
                cell.room - room_above,
            ),
            _Cell(boxes[above].copy(), ids[above].copy(), box_above, depth, bad_splits, room_above),
        )
        cell.forget_references()

    def _grow_subtrees(self, subtrees: list[_Cell], progress: Progress | None) -> None:
        # Large ones first, so that threads end together.
        ordered = sorted(subtrees, key=lambda cell: -cell.size)
        count = len(self.prim_ids)

        def body(begin: int, end: int) -> None:
            for cell in ordered[begin:end] or [self._nothing()]:
                self._grow(cell)

        def report(done: int, total: int) -> None:
            if progress:
                progress(count * done // total, count)

        parallel_for(body, len(ordered), 1, report)

    def _grow(self, cell: _Cell) -> None:
        room = max(cell.room, cell.size)
        boxes, ids = cell.working_copy(2 * room + cell.size)
        nodes = np.empty((4 * room + 1, 2), np.int32)
        prim_ids = np.empty((room // 4 + len(nodes) // 2 + 2, 4), np.int32)
        result = np.zeros(2, np.int64)
        grow_subtree(
            boxes,
            ids,
            cell.size,
            cell.box,
            cell.depth,
            min(self.method.max_depth, MAX_DEPTH),
            cell.bad_splits,
            room,
            self.method.max_leaf_size,
            self.corners,
            self.bound,
            self.method.costs,
            nodes,
            prim_ids,
            result,
        )
        node_count, block_count = result.tolist()
        if cell.size == 0:  # an empty leaf
            nodes[0] = 0, LEAF_AXIS
            node_count = 1
        cell.nodes = nodes[:node_count].copy()
        cell.prim_ids = prim_ids[:block_count].copy()
        cell.forget_references()

    def _join(self, cells: list[_Cell], subtrees: list[_Cell]) -> KdArrays:
        """Put the top and the subtrees into one tree."""
        end = 1
        for cell in cells:
            if cell.parts:
                for side, part in enumerate(cell.parts):
                    part.slot = end + side
                end += 2
        node_counts = np.array([len(cell.nodes) - 1 for cell in subtrees])
        block_counts = np.array([len(cell.prim_ids) for cell in subtrees])
        bases = end + np.cumsum(node_counts) - node_counts
        first_blocks = np.cumsum(block_counts) - block_counts
        node_total = end + int(node_counts.sum())
        if node_total > MAX_NODES:
            raise ValueError(f"{node_total:,} nodes are more than {MAX_NODES:,}")
        tree = KdArrays(
            np.empty((node_total, 2), np.int32),
            np.empty((int(block_counts.sum()), 4), np.int32),
        )
        for cell in cells:
            if cell.parts:
                position = np.array([cell.position], np.float32).view(np.int32)[0]
                tree.nodes[cell.slot] = position, cell.parts[0].slot << 2 | cell.axis
        for cell, base, first in zip(subtrees, bases.tolist(), first_blocks.tolist(), strict=True):
            place_subtree(0, len(cell.nodes), cell.nodes, cell.slot, base, first, tree.nodes)
            tree.prim_ids[first : first + len(cell.prim_ids)] = cell.prim_ids
        return tree
