"""Inspecting graphs of sectors in NumPy, for tests."""

from __future__ import annotations

import numpy as np

from raystream.structures.clip import BOUND
from raystream.structures.graph.build import graph_box
from raystream.structures.graph.layout import NODE_BIT, VOID

#: A box is certainly listed if it meets a triangle grown by a little less than the bound.
SURELY = 0.9


class View:
    """A graph, decoded."""

    def __init__(self, arrays):
        count = self.count = arrays.sector_count
        self.arrays = arrays
        sectors = arrays.rows[: 4 * count].reshape(count, 16)
        self.low = np.ascontiguousarray(sectors[:, 0:3]).view(np.float32)
        self.high = np.ascontiguousarray(sectors[:, 4:7]).view(np.float32)
        self.first_block, self.list_size = sectors[:, 3], sectors[:, 7]
        self.links = sectors[:, 8:14]
        self.nodes = arrays.rows[4 * count :]
        self.planes = np.ascontiguousarray(self.nodes[:, 0]).view(np.float32)
        self.axes, self.node_links = self.nodes[:, 1], self.nodes[:, 2:]

    def listed(self, sector):
        """The triangles of a sector."""
        first, count = int(self.first_block[sector]), int(self.list_size[sector])
        return self.arrays.prim_ids[first : first + -(-count // 4)].ravel()[:count]

    def holds(self, sectors, points):
        """Whether each point is in its sector's half-open box."""
        return ((self.low[sectors] <= points) & (points < self.high[sectors])).all(axis=-1)

    def node_of(self, link):
        return int(link) - NODE_BIT - 4 * self.count

    def follow(self, links, points):
        """The sectors that links lead to from points of their faces; -1 for none."""
        links = np.array(links, np.int64)
        is_void = links == VOID
        links[is_void] = 0
        while (inner := np.flatnonzero(links & NODE_BIT)).size:
            node = links[inner] - NODE_BIT - 4 * self.count
            is_above = points[inner, self.axes[node]] >= self.planes[node]
            links[inner] = self.node_links[node, is_above.astype(int)]
        assert (links % 4 == 0).all()
        return np.where(is_void, -1, links // 4)

    def points_behind(self, face, rng, share=None):
        """A point of each sector's face, moved to just behind it, and the same just before it."""
        axis, is_high = face >> 1, face & 1
        share = rng.random((self.count, 3), np.float32) if share is None else share
        points = self.low + (self.high - self.low) * share
        points = np.clip(points, self.low, np.nextafter(self.high, np.float32(-np.inf)))
        behind, before = points.copy(), points
        plane = (self.low, self.high)[is_high][:, axis]
        less = np.nextafter(plane, np.float32(-np.inf))
        behind[:, axis], before[:, axis] = (plane, less) if is_high else (less, plane)
        return behind, before


def assert_tiles(view, triangles, rng):
    box = graph_box(triangles).astype(float)
    assert (view.low < view.high).all()
    assert (view.low.min(axis=0) == box[0]).all()
    assert (view.high.max(axis=0) == box[1]).all()
    volume = (view.high.astype(float) - view.low).prod(axis=1).sum()
    np.testing.assert_allclose(volume, (box[1] - box[0]).prod(), rtol=1e-9)
    corners = view.low[rng.integers(0, view.count, 50)]
    points = np.concatenate([rng.uniform(*box, (50, 3)).astype(np.float32), corners])
    points = np.clip(points, box[0], np.nextafter(box[1].astype(np.float32), np.float32(-np.inf)))
    for point in points.astype(np.float32):
        assert view.holds(slice(None), point).sum() == 1


def assert_links(view, rng):
    """Links lead to the sectors just behind, and back."""
    lowest, highest = view.low.min(axis=0), view.high.max(axis=0)
    for face in range(6):
        axis, is_high = face >> 1, face & 1
        sides = (view.low, view.high)[is_high][:, axis]
        at_side = sides == (lowest, highest)[is_high][axis]
        assert ((view.links[:, face] == VOID) == at_side).all()
        for share in (None, None, np.float32(0.0), np.float32(1.0)):
            behind, before = view.points_behind(face, rng, share)
            inner = np.flatnonzero(~at_side)
            there = view.follow(view.links[inner, face], behind[inner])
            assert view.holds(there, behind[inner]).all()
            assert (view.follow(view.links[there, face ^ 1], before[inner]) == inner).all()


def assert_nodes(view):
    """Planes cut the faces that link to them; returns the depth of the deepest tree."""
    first = 4 * view.count
    links = view.node_links.astype(np.int64)
    number = np.arange(len(links))[:, None]
    is_node = links & NODE_BIT != 0
    target = np.where(is_node, links - NODE_BIT - first, links // 4)
    assert (target[is_node] < np.broadcast_to(number, links.shape)[is_node]).all()
    assert (target[~is_node] < view.count).all()
    assert (target >= 0).all()
    assert len(np.unique(view.nodes, axis=0)) == len(view.nodes)
    used, deepest = np.zeros(len(links), bool), 0
    for sector in range(view.count):
        for face in range(6):
            box = np.array([view.low[sector], view.high[sector]])
            pending = [(int(view.links[sector, face]), box, 0)]
            while pending:
                link, box, depth = pending.pop()
                deepest = max(deepest, depth)
                if link == VOID or not link & NODE_BIT:
                    continue
                node = view.node_of(link)
                axis, plane = view.axes[node], view.planes[node]
                used[node] = True
                assert axis != face >> 1
                assert box[0, axis] < plane < box[1, axis]
                for side in range(2):
                    part = box.copy()
                    part[1 - side, axis] = plane
                    pending.append((int(view.node_links[node, side]), part, depth + 1))
    assert used.all()
    return deepest


def assert_lists(view, triangles):
    """Sectors list the triangles that brute force finds in them once, in their own blocks."""
    corners = triangles.corners[triangles.prim_ids].astype(float)
    reach = SURELY * BOUND * float(triangles.max_coordinate)
    low, high = corners.min(axis=1) - reach, corners.max(axis=1) + reach
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(one, other)
    length = np.abs(normal).sum(axis=1)
    is_flat = length > 2.0**-28 * np.abs(one).sum(axis=1) * np.abs(other).sum(axis=1)
    blocks = 0
    for sector in range(view.count):
        inner_low = np.maximum(low, view.low[sector])
        inner_high = np.minimum(high, view.high[sector])
        ends = np.stack([inner_low - corners[:, 0], inner_high - corners[:, 0]]) * normal[None]
        least, most = ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)
        meets = (inner_low < inner_high).all(axis=1)
        meets &= ~is_flat | ((least < reach * length) & (most > -reach * length))
        listed = view.listed(sector)
        assert np.isin(triangles.prim_ids[meets], listed).all()
        assert len(np.unique(listed)) == len(listed)
        assert view.first_block[sector] == blocks
        blocks += -(-len(listed) // 4)
    assert blocks == len(view.arrays.prim_ids)
    absent = view.arrays.prim_ids == -1
    assert absent.sum() == 4 * blocks - view.list_size.sum()
    assert np.isin(view.arrays.prim_ids[~absent], triangles.prim_ids).all()


def assert_bins(view, triangles):
    bins = view.arrays.bins
    low, high = graph_box(triangles)
    for i in np.ndindex(*np.minimum(bins.shape, 6)):
        place = np.array(i) * (np.array(bins.shape) // np.minimum(bins.shape, 6))
        corner = low + place.astype(np.float32) * ((high - low) / np.float32(bins.shape))
        assert bins[tuple(place)] % 4 == 0
        assert view.holds(bins[tuple(place)] // 4, corner.astype(np.float32))


def assert_sound(arrays, triangles, rng):
    """Check all invariants of a graph; returns the depth of its deepest tree of link nodes."""
    view = View(arrays)
    assert_tiles(view, triangles, rng)
    assert_links(view, rng)
    assert_lists(view, triangles)
    assert_bins(view, triangles)
    return assert_nodes(view)
