"""Looking at graphs of sectors in NumPy, for tests."""

from __future__ import annotations

import numpy as np

from raystream.structures.graph.layout import NODE_BIT, VOID


class View:
    """A graph, taken apart."""

    def __init__(self, arrays):
        count = arrays.sector_count
        self.arrays = arrays
        sectors = arrays.rows[: 4 * count].reshape(count, 16)
        self.low = np.ascontiguousarray(sectors[:, 0:3]).view(np.float32)
        self.high = np.ascontiguousarray(sectors[:, 4:7]).view(np.float32)
        self.first_block, self.list_size = sectors[:, 3], sectors[:, 7]
        self.links = sectors[:, 8:14]
        self.nodes = arrays.rows[4 * count :]
        self.planes = np.ascontiguousarray(self.nodes[:, 0]).view(np.float32)
        self.axes, self.node_links = self.nodes[:, 1], self.nodes[:, 2:]

    @property
    def first_node(self):
        return 4 * self.arrays.sector_count

    def listed(self, sector):
        """The triangles of a sector."""
        first, count = int(self.first_block[sector]), int(self.list_size[sector])
        return self.arrays.prim_ids[first : first + -(-count // 4)].ravel()[:count]

    def sector_of(self, points):
        """The sector whose half-open box holds each point, -1 outside of all; no two may."""
        found = np.full(len(points), -1)
        for i, point in enumerate(points):
            held = np.flatnonzero(((self.low <= point) & (point < self.high)).all(axis=1))
            assert len(held) <= 1
            found[i] = held[0] if len(held) else -1
        return found

    def follow(self, links, points):
        """The sectors that links lead to from points of their faces; -1 for none."""
        links = np.array(links, np.uint32)
        is_void = links == VOID
        links[is_void] = 0
        for _ in range(65):
            inner = links & NODE_BIT != 0
            if not inner.any():
                break
            node = np.where(inner, links & (NODE_BIT - 1), self.first_node) - self.first_node
            node = node.astype(int) if len(self.nodes) else np.zeros(len(links), int)
            at = points[np.arange(len(points)), self.axes[node]]
            links = np.where(inner, self.node_links[node, (at >= self.planes[node]) * 1], links)
        assert (links % 4 == 0).all()
        return np.where(is_void, -1, links.astype(int) // 4)
