"""Building the graph of sectors: the leaves of a kd-tree that was grown for it, and their links.

A ray pays for the sectors that it crosses, for the link nodes between them, and for triangles;
what is above the leaves in the tree costs nothing. With random rays, and areas as a share of the
scene's box:

    J = sum over sectors: area * (crossing + intersection * triangles)
        + sum over faces: area * link * depth of its link nodes

The sum of the sectors' areas grows by twice the plane's cross-section in a split; and faces that
look at the cell's sides from outside get a link node more, wherever the plane cuts them: in
all, at most the cell's area less those two sides that are parallel to the plane; and about half
of that. So a split is worth it by the kd-tree's own rule, with ``link / 2`` for a step at it, and
``crossing - link / 2`` for its plane.

References
----------
Gribble and Naveros, "GPU Ray Tracing with Rayforce", SIGGRAPH 2013 posters: sectors "minimise a
function that represents traversal cost", which is not given.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.graph.bins import fill_bins
from raystream.structures.graph.cells import find_cells
from raystream.structures.graph.layout import SECTOR_ROWS, GraphArrays
from raystream.structures.graph.links import link_sectors
from raystream.structures.graph.order import fill_sectors, order_sectors
from raystream.structures.graph.prune import prune
from raystream.structures.kdtree.build import build_arrays, root_box
from raystream.structures.kdtree.layout import LEAF_AXIS
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.subtree import BuildSettings

__all__ = ["GraphSettings", "build_graph", "graph_box", "tree_settings_of"]

#: Share of the bound on new link nodes that a split is charged: that with which J is least
#: (bunny 167 with this, 168 with all, 170 without; conference 107, 108, 108).
_LINK_SHARE = 0.5

#: Share of the work that is done when the tree is.
_TREE_SHARE = 0.75


class GraphSettings(NamedTuple):
    """How to choose sectors.

    Attributes
    ----------
    crossing_cost, intersection_cost, link_cost : float
        Time of a step from sector to sector, of a triangle test, and of a step at a link node;
        only their ratios matter.
    empty_bonus : float
        Share of its price by which a split is cheaper that cuts off empty space.
    max_depth : int
        Splits on a path of the tree.
    max_leaf_size : int
        Cells of so many triangles are not split.
    """

    crossing_cost: float
    intersection_cost: float
    link_cost: float
    empty_bonus: float
    max_depth: int
    max_leaf_size: int


def graph_box(triangles: Triangles) -> NDArray[np.float32]:
    """The box that sectors tile, shape (2, 3): the kd-tree's."""
    return root_box(triangles)


def build_graph(
    triangles: Triangles, settings: GraphSettings, progress: Progress | None = None
) -> GraphArrays:
    """Build a graph of sectors.

    Parameters
    ----------
    triangles : Triangles
    settings : GraphSettings
    progress : callable, optional
        Called with (triangles placed, triangles); the last ones are placed when all is linked.

    Returns
    -------
    GraphArrays
        The same ones for any number of threads. Sectors tile `graph_box`; without triangles,
        there are none.

    Raises
    ------
    ValueError
        If the graph would be too large for its links: beyond 2 billion rows.
    MemoryError
        If there is not enough memory.

    Notes
    -----
    Sectors have at most `kdtree.build.MAX_REFERENCES` references for each triangle.
    """
    if len(triangles.prim_ids) == 0:
        return GraphArrays(
            np.zeros((0, 4), np.uint32),
            0,
            np.zeros((0, 4), np.int32),
            np.zeros((0, 0, 0), np.uint32),
        )
    count = len(triangles.prim_ids)
    on_tree = _part(progress, count, 0.0, _TREE_SHARE)
    tree_settings = tree_settings_of(settings)
    tree = build_arrays(triangles, tree_settings, on_tree)
    box = graph_box(triangles)
    tree = prune(tree, find_cells(tree.nodes, box).boxes, tree_settings.costs)
    sector_count = int(np.count_nonzero(tree.nodes[:, 1] & 3 == LEAF_AXIS))
    # Boxes, ropes and links of all nodes of the tree, and the sectors themselves.
    check_memory(78 * len(tree.nodes) + 128 * sector_count, f"{sector_count:,} sectors would")
    cells = find_cells(tree.nodes, box)
    order = order_sectors(tree.nodes, cells)
    sectors = np.empty((SECTOR_ROWS * sector_count, 4), np.uint32)
    prim_ids = fill_sectors(tree, cells, order, sectors)
    on_links = _part(progress, count, _TREE_SHARE, 1.0)
    links = link_sectors(tree.nodes, cells, order, sectors, on_links)
    bins = fill_bins(tree.nodes, order, box)
    return GraphArrays(np.concatenate([sectors, links]), sector_count, prim_ids, bins)


def tree_settings_of(settings: GraphSettings) -> BuildSettings:
    """How to grow the kd-tree of a graph."""
    link = _LINK_SHARE * float(settings.link_cost)
    crossing = float(settings.crossing_cost) - link
    costs = Costs(link, float(settings.intersection_cost), float(settings.empty_bonus), crossing)
    return BuildSettings(costs, settings.max_depth, settings.max_leaf_size)


def _part(progress: Progress | None, count: int, begin: float, end: float) -> Progress | None:
    """The callback for a part of the work, in terms of triangles."""
    if progress is None:
        return None
    report = progress

    def whole(done: int, total: int) -> None:
        report(int(count * (begin + (end - begin) * done / total)), count)

    return whole
