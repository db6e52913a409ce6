"""The graph of sectors as shaders read it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.packing import FAR
from raystream.graphics.structures.base import ShaderStructure, budget_for, numbers
from raystream.structures.graph.layout import NODE_BIT, SECTOR_ROWS
from raystream.structures.graph.structure import GraphStructure
from raystream.structures.kdtree.options import MAX_DEPTH

_PAD = 0

#: Upper bound of consecutive link nodes: more than splits on a path.
_MOST_PASSES = 3 * MAX_DEPTH


def shader_structure(graph: GraphStructure) -> ShaderStructure:
    """Sectors and link nodes, leaf blocks, and bins."""
    at, sector_count = graph.view, graph.graph.sector_count
    tree = numbers(
        *(*at.low, sector_count, *at.high, _PAD, *at.bin_counts, _PAD),
        *(*at.bin_low, _PAD, *at.bin_scales, _PAD),
    )
    # Each sector at most three times: back to the first one, forward to it, and to the end.
    depth = _most_nodes(graph.rows[SECTOR_ROWS * sector_count :], SECTOR_ROWS * sector_count)
    most = 3 * sector_count * (1 + depth) + len(graph.blocks)
    return ShaderStructure(
        name="graph",
        shader="graph.wgsl",
        tree=tree,
        arrays=(_finite(graph.rows, sector_count), graph.blocks, graph.graph.bins),
        budget=budget_for(most),
    )


def _finite(rows: NDArray[np.uint32], sector_count: int) -> NDArray[np.uint32]:
    """Rows without planes at infinity; see graph.wgsl."""
    rows = rows.copy()
    planes = rows[: SECTOR_ROWS * sector_count].view(np.float32).reshape(-1, SECTOR_ROWS, 4)
    planes[:, :2, :3] = np.clip(planes[:, :2, :3], -FAR, FAR)
    return rows


def _most_nodes(nodes: NDArray[np.uint32], first: int) -> int:
    """Most link nodes behind a link, or all of them; `first` is the row of the first one."""
    below, above = (
        np.where(links & NODE_BIT, (links & (NODE_BIT - 1)).astype(np.int64) - first, -1)
        for links in (nodes[:, 2], nodes[:, 3])
    )
    depths = np.ones(len(nodes) + 1, np.int64)  # the last one is a sector's
    depths[-1] = 0
    for _ in range(min(len(nodes), _MOST_PASSES)):
        deeper = 1 + np.maximum(depths[below], depths[above])
        if (deeper == depths[:-1]).all():
            return int(depths.max())
        depths[:-1] = deeper
    return len(nodes)
