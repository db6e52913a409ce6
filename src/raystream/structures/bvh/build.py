"""Building the BVH on all threads: large ranges are split, small ones become subtrees.

Each range is one task. A large one is split in two, which become tasks; a small one is built
to the end. Which ranges are large is fixed, and subtrees are joined in the order of their
ranges, so the tree is the same for any number of threads.
"""

from __future__ import annotations

from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import kernel
from raystream.jit.threads import PROGRESS_INTERVAL, Progress, parallel_for, thread_pool
from raystream.structures.bvh.layout import BvhArrays
from raystream.structures.bvh.subtree import build_subtree, split_range, triangle_boxes

__all__ = ["build_arrays", "gather_corners"]

#: Ranges of at most this many triangles are built by one task, in about 10 ms.
SUBTREE_SIZE = 1 << 14

#: Triangles that one call of a copying loop gets.
_COPY_CHUNK = 1 << 16


@dataclass
class _Range:
    """A task, and then its result: a split in two, or a subtree."""

    begin: int
    end: int
    depth: int
    bounds: NDArray[np.float32] = field(default_factory=lambda: np.empty((2, 3), np.float32))
    parts: tuple[_Range, _Range] | None = None
    node_boxes: NDArray[np.float32] | None = None
    children: NDArray[np.int32] | None = None
    first_node: int = 0

    @property
    def node_count(self) -> int:
        return 0 if self.children is None else len(self.children)


def build_arrays(
    triangles: Triangles, max_leaf_size: int, progress: Progress | None = None
) -> BvhArrays:
    """Build a binary BVH by the binned surface area heuristic.

    Parameters
    ----------
    triangles : Triangles
    max_leaf_size : int
        Most triangles in a leaf.
    progress : callable, optional
        Called with (triangles placed, triangles).

    Returns
    -------
    BvhArrays

    References
    ----------
    Wald, "On fast Construction of SAH-based Bounding Volume Hierarchies", IEEE Symposium
    on Interactive Ray Tracing 2007.
    """
    count = len(triangles.prim_ids)
    if count == 0:
        return BvhArrays(
            np.empty((0, 2, 2, 3), np.float32),
            np.empty((0, 2, 2), np.int32),
            np.empty((0, 3, 3), np.float32),
            np.empty(0, np.int32),
        )
    boxes = np.empty((count, 2, 3), np.float32)
    prim_ids = np.empty(count, np.int32)
    source = triangles.corners, triangles.prim_ids
    parallel_for(
        lambda begin, end: triangle_boxes(begin, end, *source, prim_ids, boxes), count, _COPY_CHUNK
    )
    root = _Range(0, count, 0)
    _build_ranges(root, boxes, prim_ids, max_leaf_size, progress)
    node_boxes, children = _join(root)
    return BvhArrays(node_boxes, children, gather_corners(triangles, prim_ids), prim_ids)


def gather_corners(triangles: Triangles, prim_ids: NDArray[np.int32]) -> NDArray[np.float32]:
    """Copy the corners of triangles in this order, shape (A, 3, 3), float32."""
    corners = np.empty((len(prim_ids), 3, 3), np.float32)
    parallel_for(
        lambda begin, end: _gather_corners(begin, end, triangles.corners, prim_ids, corners),
        len(prim_ids),
        _COPY_CHUNK,
    )
    return corners


def _build_ranges(
    root: _Range,
    boxes: NDArray[np.float32],
    prim_ids: NDArray[np.int32],
    max_leaf_size: int,
    progress: Progress | None,
) -> None:
    """Run the tasks, until none is left."""

    def run(task: _Range) -> None:
        begin, end, depth = task.begin, task.end, task.depth
        if end - begin > SUBTREE_SIZE:
            middle = split_range(boxes, prim_ids, begin, end, depth, max_leaf_size, task.bounds)
            task.parts = _Range(begin, middle, depth + 1), _Range(middle, end, depth + 1)
            return
        node_boxes = np.empty((end - begin, 2, 2, 3), np.float32)
        children = np.empty((end - begin, 2, 2), np.int32)
        node_count = build_subtree(
            boxes, prim_ids, begin, end, depth, max_leaf_size, node_boxes, children, task.bounds
        )
        task.node_boxes = node_boxes[:node_count].copy()
        task.children = children[:node_count].copy()

    if root.end <= SUBTREE_SIZE:
        run(root)  # not worth a hand-over
        return
    # Compile on this thread, see `parallel_for`.
    split_range(boxes, prim_ids, 0, 0, 0, max_leaf_size, np.empty((2, 3), np.float32))
    run(_Range(0, 0, 0))
    pool = thread_pool()
    running: dict[Future[None], _Range] = {pool.submit(run, root): root}
    placed = 0
    try:
        while running:
            done, _ = wait(running, timeout=PROGRESS_INTERVAL, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                future.result()
                if task.parts:
                    running.update({pool.submit(run, part): part for part in task.parts})
                else:
                    placed += task.end - task.begin
            if progress:
                progress(placed, root.end)
    except BaseException:
        for future in running:
            future.cancel()
        wait(running)
        raise


def _join(root: _Range) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Lay out the split ranges' nodes first, then the subtrees' in the order of their ranges."""
    if root.parts is None and root.node_count == 0:
        return _single_leaf(root)
    splits: list[_Range] = []
    subtrees: list[_Range] = []
    pending = [root]
    while pending:
        task = pending.pop()
        if task.parts:
            task.first_node = len(splits)
            splits.append(task)
            pending += reversed(task.parts)
        else:
            subtrees.append(task)
    total = len(splits)
    for task in subtrees:
        task.first_node = total
        total += task.node_count

    node_boxes = np.empty((total, 2, 2, 3), np.float32)
    children = np.empty((total, 2, 2), np.int32)
    for task in splits:
        for side, part in enumerate(task.parts or ()):
            node_boxes[task.first_node, side] = part.bounds
            if part.parts is None and part.node_count == 0:
                children[task.first_node, side] = part.begin, part.end - part.begin
            else:
                children[task.first_node, side] = part.first_node, 0
    for task in subtrees:
        rows = slice(task.first_node, task.first_node + task.node_count)
        if task.children is not None and task.node_boxes is not None:
            node_boxes[rows] = task.node_boxes
            inner = task.children[:, :, 1] == 0
            task.children[:, :, 0] += np.where(inner, np.int32(task.first_node), np.int32(0))
            children[rows] = task.children
    return node_boxes, children


def _single_leaf(root: _Range) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """A node with one child: the whole scene as a leaf."""
    node_boxes = np.empty((1, 2, 2, 3), np.float32)
    node_boxes[0, 0] = root.bounds
    node_boxes[0, 1] = [[np.inf] * 3, [-np.inf] * 3]
    children = np.array([[[root.begin, root.end - root.begin], [0, -1]]], np.int32)
    return node_boxes, children


@kernel
def _gather_corners(begin, end, source, prim_ids, corners):
    for i in range(np.uint64(begin), np.uint64(end)):
        triangle = source[np.uint64(prim_ids[i])]
        for vertex in range(3):
            for axis in range(3):
                corners[i, vertex, axis] = triangle[vertex, axis]
