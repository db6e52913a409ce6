"""Building the graph of sectors: the leaves of a kd-tree built for the purpose, and their links.

A ray pays for the sectors that it crosses, for the link nodes between them, and for triangles;
inner nodes of the tree cost nothing. For random rays, and areas relative to the scene's box:

    J = sum over sectors: area * (crossing + intersection * triangles)
        + sum over faces: area * link * depth of its link nodes

A split increases the sum of the sectors' areas by twice the plane's cross-section. And adjacent
faces outside the cell get one more link node where the plane cuts them: over an area of at
most the cell's sides that are not parallel to the plane, and typically about half of that. So
the kd-tree's own rule applies, with ``link / 2`` as the cost of a traversal step, and
``crossing - link / 2`` as that of crossing its plane.

References
----------
Gribble and Naveros, "GPU Ray Tracing with Rayforce", SIGGRAPH 2013 posters: sectors "minimise a
function that represents traversal cost", which is not specified.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.graph.bins import fill_bins
from raystream.structures.graph.cells import find_cells
from raystream.structures.graph.layout import SECTOR_ROWS, GraphArrays
from raystream.structures.graph.links import link_sectors
from raystream.structures.graph.morton_order import fill_sectors, order_sectors
from raystream.structures.graph.options import Graph
from raystream.structures.graph.prune import prune
from raystream.structures.kdtree.build import build_arrays, root_box
from raystream.structures.kdtree.layout import LEAF_AXIS, depth_limit
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.subtree import BuildSettings

#: Fraction of the bound on new link nodes that a split is charged, chosen to minimise J
#: (bunny 167 with this, 168 with all, 170 without; conference 107, 108, 108).
_LINK_SHARE = 0.5

#: Fraction of the work that building the tree takes.
_TREE_SHARE = 0.75


def graph_box(triangles: Triangles) -> NDArray[np.float32]:
    """The box that sectors tile, shape (2, 3): the kd-tree's."""
    return root_box(triangles)


def build_graph(
    triangles: Triangles, options: Graph, progress: Progress | None = None
) -> GraphArrays:
    """Build a graph of sectors.

    Parameters
    ----------
    triangles : Triangles
    options : Graph
    progress : callable, optional
        Called with (triangles placed, triangles), including linking.

    Returns
    -------
    GraphArrays
        The same for any number of threads. Sectors tile `graph_box`; without triangles,
        there are none.

    Raises
    ------
    ValueError
        If the graph would be too large for its links: beyond 2 billion rows.
    MemoryError
        If there is not enough memory.

    Notes
    -----
    Sectors have at most `kdtree.build.MAX_REFERENCES` references per triangle.
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
    settings = tree_settings_of(options, count)
    tree = build_arrays(triangles, settings, on_tree)
    box = graph_box(triangles)
    tree = prune(tree, find_cells(tree.nodes, box).boxes, settings.costs)
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


def tree_settings_of(options: Graph, triangle_count: int) -> BuildSettings:
    """The build settings of a graph's kd-tree."""
    link = _LINK_SHARE * float(options.link_cost)
    costs = Costs(
        traversal=link,
        intersection=float(options.intersection_cost),
        empty_bonus=0.0,
        crossing=float(options.crossing_cost) - link,
    )
    max_depth = depth_limit(options.max_depth, triangle_count)
    return BuildSettings(costs, max_depth, options.max_leaf_size)


def _part(progress: Progress | None, count: int, begin: float, end: float) -> Progress | None:
    """The callback for a fraction of the work, in terms of triangles."""
    if progress is None:
        return None
    report = progress

    def whole(done: int, total: int) -> None:
        report(int(count * (begin + (end - begin) * done / total)), count)

    return whole
