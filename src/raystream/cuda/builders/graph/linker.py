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
from raystream.jit.cuda.scan import scan, scan_in_place
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
    """

    table: LinkTable
    node_count: int
    raw: Raw
    links: DeviceArray

    def write(self, gpu: Gpu, rows: DeviceArray) -> None:
        """Launch the kernels that write them to a graph's rows, which have their sectors."""
        given = self.links, self.raw, self.table, rows
        link_kernels.place_links.launch(gpu, len(self.links), given)
        self.table.write(gpu, rows)


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
        self.gpu, self.grown, self.ordered = gpu, grown, ordered
        self.node_count, self.sector_count = len(grown.nodes), len(ordered.leaves)
        self.axes = gpu.empty("axes of subtrees", self.node_count, np.uint8)
        self.is_covered = gpu.zeros("covered faces", (self.node_count, 6), np.uint8)
        self.covered = gpu.empty("links to covered", (self.node_count, 6), np.uint32)
        at = grown.nodes, self.axes, grown.boxes, ordered.ropes
        self.tree = RopeTree(*(one.address for one in at))

    def link(self) -> Linked:
        firsts = self._count()
        order, covered_count = self._order_covered()
        ends = np.array([0, *(firsts[end] for _, end in batches(firsts))], np.uint64)
        raw_count = int(firsts[-1])
        first_row = SECTOR_ROWS * self.sector_count
        table = LinkTable.empty(self.gpu, covered_count + raw_count, first_row)
        self._link_covered(order, table)
        raw, links = self._fill(raw_count, ends[1:], covered_count)
        for height in range(1, int(raw.tops.host()[0]) + 1):
            of = np.uint64(height)
            link_kernels.put_raw.launch(self.gpu, raw_count, (of, self.grown.nodes, raw, table))
            link_kernels.share_raw.launch(self.gpu, raw_count, (of, raw, table))
        return Linked(table, table.rank(self.gpu), raw, links)

    def _count(self) -> NDArray[np.int64]:
        """Count raw nodes, and mark everything that covered subtrees need."""
        gpu, grown, count, marks = self.gpu, self.grown, self.sector_count, self.is_covered
        find_axes = link_kernels.find_node_axes, (grown.nodes, self.axes)
        grown.launch_by_level(gpu, find_axes, upward=True)
        self.firsts = gpu.empty("first raw nodes", count + 1, np.uint64)
        given = self.ordered.leaves, self.tree, marks, self.firsts
        link_kernels.count_raw.launch(gpu, count, given)
        scan(gpu, self.firsts)
        grown.launch_by_level(gpu, (link_kernels.spread_covered, (grown.nodes, marks)))
        return self.firsts.host().view(np.int64)

    def _order_covered(self) -> tuple[CandidateOrder, int]:
        """Order the link nodes of covered subtrees, and count them."""
        by_row, row_count = self.ordered.by_row, np.uint64(len(self.ordered.by_row))
        before = self.gpu.empty("covered link nodes", 6 * len(by_row) + 1, np.uint32)
        given = self.grown.nodes, by_row, row_count, self.is_covered, before
        link_kernels.mark_covered.launch(self.gpu, 6 * len(by_row), given)
        count = scan_in_place(self.gpu, before)
        return CandidateOrder(self.ordered.rows, row_count, before), count

    def _link_covered(self, order: CandidateOrder, table: LinkTable) -> None:
        nodes, to = self.grown.nodes, (self.is_covered, order, self.covered, table)
        self.grown.launch_by_level(
            self.gpu,
            (link_kernels.put_covered, (nodes, self.ordered.sectors, *to)),
            (link_kernels.share_covered, (nodes, *to)),
            upward=True,
        )

    def _fill(
        self, raw_count: int, ends: NDArray[np.uint64], first: int
    ) -> tuple[Raw, DeviceArray]:
        """Launch the kernel that writes raw nodes and raw links."""
        gpu, ordered = self.gpu, self.ordered
        raw = Raw(
            gpu.empty("raw nodes", (raw_count, 3), np.uint64),
            gpu.empty("heights of raw nodes", raw_count, np.uint8),
            gpu.zeros("greatest height", 1, np.uint32),
            gpu.upload("batches", ends),
            np.uint64(first),
        )
        links = gpu.empty("raw links", (self.sector_count, 6), np.uint64)
        source = ordered.leaves, self.tree, ordered.sectors, self.covered, self.firsts
        link_kernels.fill_raw.launch(gpu, self.sector_count, (*source, raw, links))
        return raw, links
