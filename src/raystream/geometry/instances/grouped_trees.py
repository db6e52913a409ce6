"""Trees over the instances of many worlds, built at once: groups of eight neighbours.

`structures.bvh.build` takes a millisecond for a tree, however small. Here all worlds are sorted
along a Morton curve, and every eight neighbours of a world become a node, then every eight nodes,
until each world has a root.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.kernels.aligned import aligned_array
from raystream.structures.bvh.layout import CHILDREN_AT, NODE_FLOATS, WIDTH

#: Cells of the Morton curve along each axis of a world.
_CELLS = 1 << 10

_Boxes = NDArray[np.float32]


class GroupedTrees(NamedTuple):
    """The trees of worlds, one after another.

    Attributes
    ----------
    nodes : ndarray of shape (M, 64), float32
        See `BvhArrays`. The links of a tree count from its own first node and leaf.
    first_nodes, first_leaves : ndarray of shape (W + 1,), int64
        World w has the nodes first_nodes[w] to first_nodes[w + 1], and likewise leaves.
    order : ndarray of shape (N,), int64
        The box of each leaf.
    """

    nodes: NDArray[np.float32]
    first_nodes: NDArray[np.int64]
    first_leaves: NDArray[np.int64]
    order: NDArray[np.int64]


class _Level(NamedTuple):
    """Nodes of all worlds whose children are of the level below."""

    worlds: NDArray[np.int64]
    low: _Boxes
    high: _Boxes
    first: NDArray[np.int64]  # children, among those of the level below
    child_count: NDArray[np.int64]


def grouped_trees(
    low: _Boxes, high: _Boxes, worlds: NDArray[np.int64], world_count: int
) -> GroupedTrees:
    """Build a tree over the boxes of each world.

    Parameters
    ----------
    low, high : ndarray of shape (N, 3), float32
    worlds : ndarray of shape (N,), int64
        The world of each box.
    world_count : int
    """
    order = np.lexsort((_morton_codes(low, high, worlds, world_count), worlds))
    worlds = worlds[order]
    leaves = _Level(worlds, low[order], high[order], order, order)  # without children
    first_leaves = np.searchsorted(worlds, np.arange(world_count + 1))
    levels = [_grouped(leaves, world_count)]
    while (np.bincount(levels[-1].worlds, minlength=world_count) > 1).any():
        levels.append(_grouped(levels[-1], world_count))
    # A world that has its root already is passed on as a node with one child: that is left out.
    counts = np.array([np.bincount(one.worlds, minlength=world_count) for one in levels])
    for upper in range(len(levels) - 1, 0, -1):
        counts[upper, counts[upper - 1] == 1] = 0
    rows = np.cumsum(counts[::-1], axis=0)[::-1] - counts  # a root is row 0
    first_nodes = np.concatenate([[0], np.cumsum(counts.sum(axis=0))])
    nodes = aligned_array(int(first_nodes[-1]), NODE_FLOATS)
    nodes[:] = 0.0
    planes = nodes[:, : CHILDREN_AT // 4].reshape(-1, 3, 2, WIDTH)
    planes[:, :, 0], planes[:, :, 1] = np.inf, -np.inf
    links = nodes.view(np.int32)[:, CHILDREN_AT // 4 : CHILDREN_AT // 4 + WIDTH]
    below, firsts = leaves, first_leaves
    for k, level in enumerate(levels):
        starts = np.searchsorted(level.worlds, np.arange(world_count + 1))
        kept = np.flatnonzero(counts[k][level.worlds] > 0)
        mine = level.worlds[kept]
        to = first_nodes[mine] + rows[k][mine] + kept - starts[mine]
        for lane in range(WIDTH):
            has = level.child_count[kept] > lane
            child = level.first[kept[has]] + lane
            planes[to[has], :, 0, lane] = below.low[child]
            planes[to[has], :, 1, lane] = below.high[child]
            place = child - firsts[mine[has]]  # among the world's own of that level
            links[to[has], lane] = ~(place << 3) if k == 0 else rows[k - 1][mine[has]] + place
        below, firsts = level, starts
    return GroupedTrees(nodes, first_nodes, first_leaves, order)


def _grouped(below: _Level, world_count: int) -> _Level:
    """Nodes over every eight neighbours of the same world."""
    firsts = np.searchsorted(below.worlds, np.arange(world_count + 1))
    rank = np.arange(len(below.worlds)) - firsts[below.worlds]
    begin = np.flatnonzero(rank % WIDTH == 0)
    if not len(begin):
        return _Level(below.worlds, below.low, below.high, begin, begin)
    low = np.minimum.reduceat(below.low, begin)
    high = np.maximum.reduceat(below.high, begin)
    return _Level(below.worlds[begin], low, high, begin, np.diff(begin, append=len(below.worlds)))


def _morton_codes(
    low: _Boxes, high: _Boxes, worlds: NDArray[np.int64], world_count: int
) -> NDArray[np.int64]:
    """Morton codes of the boxes' centres, within the bounds of their worlds."""
    centers = (low.astype(np.float64) + high) / 2.0
    least = np.full((world_count, 3), np.inf)
    most = np.full((world_count, 3), -np.inf)
    np.minimum.at(least, worlds, centers)
    np.maximum.at(most, worlds, centers)
    extent = np.maximum(most - least, 1e-300)[worlds]
    cells = ((centers - least[worlds]) / extent * (_CELLS - 1)).astype(np.int64)
    codes = np.zeros(len(centers), np.int64)
    for bit in range(10):
        for axis in range(3):
            codes |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return codes
