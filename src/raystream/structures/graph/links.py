"""Linking sectors through their faces.

Behind a face is a subtree of the kd-tree, of which only the splits matter that cut the face's
rectangle. At a split on the face's own axis the child that touches the face is taken, at one
that misses the rectangle the child on its side; the other splits become link
nodes. Where a face covers a subtree, along the axes of the subtree's splits, its link nodes are
the same for all such faces, and are made once.

References
----------
Havran, Bittner and Zara, "Ray tracing with rope trees", Spring Conference on Computer Graphics
1998.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import kernel
from raystream.jit.simd import address, load, scratch, store
from raystream.jit.threads import Progress, parallel_for
from raystream.structures.clip import WORD
from raystream.structures.graph.cells import ROPE_BYTES, Cells, split_of
from raystream.structures.graph.face_subtrees import (
    PENDING_BYTES,
    RopeTree,
    count_raw_nodes,
    find_axes,
    propagate_marks,
    write_raw_nodes,
)
from raystream.structures.graph.hash_consing import RAW, NodeStore, put_node
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.morton_order import SECTOR_BYTES, Order
from raystream.structures.kdtree.layout import LEAF_AXIS

#: Raw nodes per batch, if no single sector has more.
_BATCH = 1 << 22

_CHUNK = 1 << 11

#: Bytes of a sector's raw links, and from a sector's row to its links.
RAW_LINKS = np.uint64(48)
LINKS_AT = np.uint64(32)

_SIX = np.uint64(6)
_HALF_ROW = np.uint64(8)
_RAW_BYTES = np.uint64(24)
_RAW_BIT = np.uint64(RAW)
_ROWS = np.uint64(SECTOR_ROWS)
_LEAF = np.uint64(LEAF_AXIS)
_YES = np.uint8(1)


@kernel
def _find_all_axes(nodes, axes):
    node_at, axes_at = address(nodes), address(axes)
    node = np.uint64(len(nodes))
    while node != ZERO_U64:
        node -= ONE_U64
        find_axes(node_at, node, axes_at)


@kernel
def _count_nodes(begin, end, leaves, tree, counts, is_covered):
    """Count the raw nodes of sectors begin to end, and mark subtrees that a face covers."""
    pending = scratch(PENDING_BYTES)
    for sector in range(np.uint64(begin), np.uint64(end)):
        counts[sector] = count_raw_nodes(
            np.uint64(leaves[sector]), tree, address(is_covered), pending
        )


@kernel
def _propagate_all_marks(nodes, is_covered):
    """Mark what the link nodes of marked subtrees need; returns the number of these."""
    total = ZERO_U64
    for node in range(np.uint64(len(nodes))):
        total += propagate_marks(address(nodes), node, address(is_covered))
    return total


@kernel
def _link_covered(nodes, sectors, is_covered, covered, rows, table, count, first_row):
    """Make the link nodes of marked subtrees; returns the number of nodes."""
    node_at, mark_at, link_at = address(nodes), address(is_covered), address(covered)
    row_at, table_at = address(rows), address(table)
    mask, end = np.uint64(len(table)) - ONE_U64, np.uint64(count)
    node = np.uint64(len(nodes))
    while node != ZERO_U64:
        node -= ONE_U64
        axis, first, _ = split_of(node_at, node)
        plane_bits = np.uint64(load(np.uint32, node_at + node * _HALF_ROW))
        for face in range(_SIX):
            if load(np.uint8, mark_at + node * _SIX + face) != _YES:
                continue
            below = link_at + first * ROPE_BYTES + face * WORD
            above = below + ROPE_BYTES
            if axis == _LEAF:
                link = np.uint64(sectors[node]) * _ROWS
            elif face >> ONE_U64 == axis:
                link = np.uint64(load(np.uint32, above if face & ONE_U64 == ZERO_U64 else below))
            else:
                less = np.uint64(load(np.uint32, below))
                more = np.uint64(load(np.uint32, above))
                number, end = put_node(row_at, table_at, mask, end, plane_bits, axis, less, more)
                link = np.uint64(0x80000000) | (np.uint64(first_row) + number)
            store(link_at + node * ROPE_BYTES + face * WORD, np.uint32(link))
    return end


@kernel
def _fill_nodes(begin, end, base, order, tree, covered, firsts, raw, links):
    """Write the raw nodes and raw links of sectors base + begin to base + end."""
    leaves, sector_at, covered_at = order.leaves, address(order.sectors), address(covered)
    raw_at, link_at = address(raw), address(links)
    pending = scratch(PENDING_BYTES)
    for i in range(np.uint64(begin), np.uint64(end)):
        sector = np.uint64(base) + i
        number = np.uint64(firsts[sector]) - np.uint64(firsts[base])
        to = link_at + i * RAW_LINKS
        leaf = np.uint64(leaves[sector])
        write_raw_nodes(leaf, tree, sector_at, covered_at, number, raw_at, to, pending)


@kernel
def _place_links(begin, end, base, raw, links, rows):
    """Write the links of sectors base + begin to base + end, given the links of raw nodes."""
    raw_at, row_at = address(raw), address(rows)
    for i in range(np.uint64(begin), np.uint64(end)):
        to = row_at + (np.uint64(base) + i) * SECTOR_BYTES + LINKS_AT
        for face in range(_SIX):
            link = np.uint64(links[i, face])
            if link & _RAW_BIT:
                link = load(np.uint64, raw_at + (link ^ _RAW_BIT) * _RAW_BYTES)
            store(to + face * WORD, np.uint32(link))


def batches(firsts: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """Ranges of sectors to link together, given the first raw node of each."""
    begin = 0
    while begin + 1 < len(firsts):
        end = int(np.searchsorted(firsts, firsts[begin] + _BATCH, "right")) - 1
        yield begin, (begin := max(end, begin + 1))


class _Linker:
    def __init__(
        self, nodes: NDArray[np.int32], cells: Cells, order: Order, rows: NDArray[np.uint32]
    ) -> None:
        self.nodes, self.cells, self.order, self.rows = nodes, cells, order, rows
        self.store = NodeStore(SECTOR_ROWS * len(order.leaves))
        self.axes = np.empty(len(nodes), np.uint8)
        arrays = nodes, self.axes, cells.boxes, cells.ropes
        self.tree = RopeTree(*(np.uint64(array.ctypes.data) for array in arrays))

    def link(self, progress: Progress | None) -> None:
        sector_count = len(self.order.leaves)
        firsts = self._count()
        for begin, end in batches(firsts):
            self._link_batch(begin, end, firsts)
            if progress:
                progress(end, sector_count)

    def _count(self) -> NDArray[np.int64]:
        """Count raw nodes, and make the link nodes of covered subtrees."""
        leaves, nodes = self.order.leaves, self.nodes
        _find_all_axes(nodes, self.axes)
        counts = np.empty(len(leaves), np.int64)
        is_covered = np.zeros((len(nodes), 6), np.uint8)

        def body(begin: int, end: int) -> None:
            _count_nodes(begin, end, leaves, self.tree, counts, is_covered)

        parallel_for(body, len(leaves), _CHUNK)
        self.covered = np.empty((len(nodes), 6), np.uint32)
        shared = self.store
        shared.reserve(int(_propagate_all_marks(nodes, is_covered)))
        shared.count = int(
            _link_covered(
                nodes,
                self.order.sectors,
                is_covered,
                self.covered,
                shared.rows,
                shared.table,
                shared.count,
                shared.first_row,
            )
        )
        return np.concatenate([[0], np.cumsum(counts)])

    def _link_batch(self, first: int, last: int, firsts: NDArray[np.int64]) -> None:
        raw = np.empty((int(firsts[last] - firsts[first]), 3), np.uint64)
        links = np.empty((last - first, 6), np.uint64)

        def fill(begin: int, end: int) -> None:
            given = first, self.order, self.tree, self.covered, firsts, raw, links
            _fill_nodes(begin, end, *given)

        def place(begin: int, end: int) -> None:
            _place_links(begin, end, first, raw, links, self.rows)

        parallel_for(fill, last - first, _CHUNK)
        self.store.share(raw, self.nodes)
        parallel_for(place, last - first, _CHUNK)


def link_sectors(
    nodes: NDArray[np.int32],
    cells: Cells,
    order: Order,
    rows: NDArray[np.uint32],
    progress: Progress | None = None,
) -> NDArray[np.uint32]:
    """Link all sectors.

    Parameters
    ----------
    nodes : ndarray of shape (M, 2), int32
        The kd-tree.
    cells : Cells
    order : Order
    rows : ndarray of shape (4 S, 4), uint32
        Written: the links of the sectors.
    progress : callable, optional
        Called with (sectors linked, sectors).

    Returns
    -------
    ndarray of shape (N, 4), uint32
        The link nodes, to be appended to the sectors.

    Raises
    ------
    ValueError
        If there are more rows than links can reach.
    MemoryError
        If there is not enough memory.
    """
    linker = _Linker(nodes, cells, order, rows)
    linker.link(progress)
    return linker.store.rows[: linker.store.count]
