"""Linking of all sectors in parallel.

Subtrees that a face covers get their link nodes level by level from the leaves up; all others
(raw nodes) follow by height, starting with those that link only to sectors and covered subtrees.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.builders.graph import link_kernels
from raystream.cuda.builders.graph.link_kernels import CandidateOrder, Raw
from raystream.cuda.builders.graph.sectors import Ordered
from raystream.cuda.builders.graph.sharing import LinkTable
from raystream.cuda.builders.kdtree.grow import GrownTree
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.cuda.scan import Scan
from raystream.structures.graph.face_subtrees import RopeTree
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.links import batches


class Linked(NamedTuple):
    """The links of a graph, before they are written.

    Attributes
    ----------
    table : LinkTable
        With its rows assigned.
    node_count : int
        Number of link nodes.
    raw : Raw
    links : DeviceArray of shape (S, 6), uint64
        Raw links.
    kept : tuple of DeviceArray
        The memory of `raw`.
    """

    table: LinkTable
    node_count: int
    raw: Raw
    links: DeviceArray
    kept: tuple[DeviceArray, ...]

    def write(self, gpu: Gpu, rows: DeviceArray) -> None:
        """Launch the kernels that write them to a graph's rows, which have their sectors."""
        given = self.links.address, self.raw, self.table.at, rows.address
        link_kernels.place_links.launch(gpu, len(self.links), given)
        self.table.write(rows)


def link_sectors(gpu: Gpu, grown: GrownTree, ordered: Ordered) -> Linked:
    """Link the sectors of a pruned tree.

    Parameters
    ----------
    gpu : Gpu
    grown : GrownTree
        Pruned.
    ordered : Ordered
        With its sectors numbered.

    Returns
    -------
    Linked
        Its link nodes are in the CPU's order.

    Raises
    ------
    ValueError
        If there are more rows than links can address.
    CudaError
        If device memory runs out: it takes about 70 bytes per raw node.
    """
    return _Linker(gpu, grown, ordered).link()


class _Linker:
    def __init__(self, gpu: Gpu, grown: GrownTree, ordered: Ordered) -> None:
        self.gpu, self.ordered = gpu, ordered
        self.node_count, self.sector_count = len(grown.nodes), len(ordered.leaves)
        self.levels = list(zip(grown.levels, grown.levels[1:], strict=False))
        self.axes = gpu.empty("axes of subtrees", self.node_count, np.uint8)
        self.is_covered = gpu.empty("covered faces", (self.node_count, 6), np.uint8)
        self.covered = gpu.empty("links to covered", (self.node_count, 6), np.uint32)
        gpu.clear(self.is_covered, self.is_covered.stream)
        at = grown.nodes, self.axes, grown.boxes, ordered.ropes
        self.tree = RopeTree(*(one.address for one in at))

    def link(self) -> Linked:
        firsts = self._count()
        before, row_count = self._order_covered()
        ends = np.array([0, *(firsts[end] for _, end in batches(firsts))], np.uint64)
        covered_count = int(before.part(6 * row_count, 1).host()[0])
        raw_count = int(firsts[-1])
        table = LinkTable(self.gpu, covered_count + raw_count, SECTOR_ROWS * self.sector_count)
        self._link_covered(before, row_count, table)
        raw, links, kept = self._fill(raw_count, ends[1:], covered_count)
        for height in range(1, int(kept[2].host()[0]) + 1):
            of = np.uint64(height)
            link_kernels.put_raw.launch(self.gpu, raw_count, (of, self.tree.nodes, raw, table.at))
            link_kernels.share_raw.launch(self.gpu, raw_count, (of, raw, table.at))
        return Linked(table, table.rank(), raw, links, kept)

    def _count(self) -> NDArray[np.int64]:
        """Count raw nodes, and mark everything that covered subtrees need."""
        gpu, count = self.gpu, self.sector_count
        for first, end in reversed(self.levels):
            given = np.uint64(first), self.tree.nodes, self.axes.address
            link_kernels.find_node_axes.launch(gpu, end - first, given)
        self.firsts = gpu.empty("first raw nodes", count + 1, np.uint64)
        leaves, marks = self.ordered.leaves.address, self.is_covered.address
        link_kernels.count_raw.launch(gpu, count, (leaves, self.tree, marks, self.firsts.address))
        Scan(gpu, count).run(self.firsts.address, count, self.firsts.address, np.uint64)
        for first, end in self.levels:
            given = np.uint64(first), self.tree.nodes, marks
            link_kernels.spread_covered.launch(gpu, end - first, given)
        return self.firsts.host().view(np.int64)

    def _order_covered(self) -> tuple[DeviceArray, int]:
        """Count the link nodes of covered subtrees before each row and face."""
        row_count = len(self.ordered.by_row)
        before = self.gpu.empty("covered link nodes", 6 * row_count + 1, np.uint32)
        given = self.ordered.by_row.address, np.uint64(row_count), self.is_covered.address
        link_kernels.mark_covered.launch(
            self.gpu, 6 * row_count, (self.tree.nodes, *given, before.address)
        )
        scan = Scan(self.gpu, 6 * row_count)
        scan.run(before.address, 6 * row_count, before.address, np.uint32)
        return before, row_count

    def _link_covered(self, before: DeviceArray, row_count: int, table: LinkTable) -> None:
        nodes, sectors = self.tree.nodes, self.ordered.sectors.address
        order = CandidateOrder(self.ordered.rows.address, np.uint64(row_count), before.address)
        marks, to = self.is_covered.address, (order, self.covered.address, table.at)
        for first, end in reversed(self.levels):
            begin, count = np.uint64(first), end - first
            link_kernels.put_covered.launch(self.gpu, count, (begin, nodes, sectors, marks, *to))
            link_kernels.share_covered.launch(self.gpu, count, (begin, nodes, marks, *to))

    def _fill(
        self, raw_count: int, ends: NDArray[np.uint64], first: int
    ) -> tuple[Raw, DeviceArray, tuple[DeviceArray, ...]]:
        """Launch the kernel that writes raw nodes and raw links."""
        gpu, ordered = self.gpu, self.ordered
        kept = (
            gpu.empty("raw nodes", (raw_count, 3), np.uint64),
            gpu.empty("heights of raw nodes", raw_count, np.uint8),
            gpu.upload("greatest height", np.zeros(1, np.uint32)),
            gpu.upload("batches", ends),
        )
        nodes, heights, tops, begun = (one.address for one in kept)
        raw = Raw(nodes, heights, tops, begun, np.uint64(first))
        links = gpu.empty("raw links", (self.sector_count, 6), np.uint64)
        given = self.ordered.leaves.address, self.tree, ordered.sectors.address
        to = self.covered.address, self.firsts.address, raw, links.address
        link_kernels.fill_raw.launch(gpu, self.sector_count, (*given, *to))
        return raw, links, kept
