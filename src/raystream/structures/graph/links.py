"""The links of sectors: what lies behind each face.

Behind a face is a part of the kd-tree: the subtree across the plane, of which only the splits
count that cut the face's rectangle. At a split on the face's own axis the child that touches the
face is taken, at one that passes the rectangle by the child on its side; what is left are link
nodes. Where a face covers a subtree, along the axes of the subtree's splits, its link nodes are
the same for all such faces, and are made once.

References
----------
Havran, Bittner and Zara, "Ray tracing with rope trees", Spring Conference on Computer Graphics
1998.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, load, scratch, store
from raystream.jit.threads import Progress, parallel_for
from raystream.structures.clip import BOX_BYTES, HIGH, WORD
from raystream.structures.graph.cells import ROPE_BYTES, Cells, is_leaf, settle, split_of
from raystream.structures.graph.layout import SECTOR_ROWS, VOID
from raystream.structures.graph.order import SECTOR_BYTES, Order
from raystream.structures.graph.share import RAW, NodeStore, put_node
from raystream.structures.kdtree.layout import LEAF_AXIS, MAX_DEPTH

__all__ = ["link_sectors"]

#: Raw nodes that are made at a time, if no single sector has more.
_BATCH = 1 << 22

_CHUNK = 1 << 11

#: Subtrees that wait: a node, and the address of the raw link to it.
_PENDING = np.uint64(16)
_PENDING_BYTES = 16 * (MAX_DEPTH + 2)

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_THREE = np.uint64(3)
_SIX = np.uint64(6)
_HALF_ROW = np.uint64(8)
_RAW_BYTES = np.uint64(24)
_RAW_LINKS = np.uint64(48)
_RAW_BIT = np.uint64(RAW)
_ROWS = np.uint64(SECTOR_ROWS)
_LINKS_AT = np.uint64(32)
_VOID = np.uint64(VOID)
_LEAF = np.uint64(LEAF_AXIS)
_NOWHERE = np.int32(-1)
_YES = np.uint8(1)


@kernel
def _find_axes(nodes, axes):
    """Find the axes of the splits in each subtree: bits."""
    node_at = address(nodes)
    node = np.uint64(len(nodes))
    while node != _NONE:
        node -= _ONE
        axis, first, _ = split_of(node_at, node)
        axes[node] = 0
        if axis != _LEAF:
            axes[node] = np.uint64(axes[first]) | np.uint64(axes[first + _ONE]) | _ONE << axis


@device
def _covers(box, cell, face, axes):
    """Whether a face of a box covers that side of a cell along some axes."""
    axis = face >> _ONE
    for other in range(_THREE):
        at = other * WORD
        is_out = load(np.float32, cell + at) < load(np.float32, box + at)
        is_out |= load(np.float32, cell + HIGH + at) > load(np.float32, box + HIGH + at)
        if other != axis and axes >> other & _ONE != _NONE and is_out:
            return False
    return True


@kernel
def _count_nodes(begin, end, leaves, nodes, axes, boxes, ropes, counts, is_covered):
    """Count the raw nodes of sectors begin to end, and mark subtrees that a face covers."""
    node_at, box_at, rope_at = address(nodes), address(boxes), address(ropes)
    mark_at = address(is_covered)
    pending = scratch(_PENDING_BYTES)
    for sector in range(np.uint64(begin), np.uint64(end)):
        leaf = np.uint64(leaves[sector])
        box, count = box_at + leaf * BOX_BYTES, _NONE
        for face in range(_SIX):
            rope = load(np.int32, rope_at + leaf * ROPE_BYTES + face * WORD)
            if rope == _NOWHERE:
                continue
            store(pending, np.uint64(rope))
            top = pending + _PENDING
            while top != pending:
                top -= _PENDING
                node = settle(node_at, load(np.uint64, top), face, box)
                if is_leaf(node_at, node):
                    continue
                if _covers(box, box_at + node * BOX_BYTES, face, np.uint64(axes[node])):
                    store(mark_at + node * _SIX + face, _YES)
                    continue
                count += _ONE
                _, first, _ = split_of(node_at, node)
                store(top, first)
                store(top + _PENDING, first + _ONE)
                top += _PENDING + _PENDING
        counts[sector] = count


@kernel
def _spread_marks(nodes, is_covered):
    """Mark what the link nodes of marked subtrees need; returns how many these are."""
    node_at, mark_at = address(nodes), address(is_covered)
    total = _NONE
    for node in range(np.uint64(len(nodes))):
        axis, first, _ = split_of(node_at, node)
        if axis == _LEAF:
            continue
        for face in range(_SIX):
            if load(np.uint8, mark_at + node * _SIX + face) != _YES:
                continue
            if face >> _ONE == axis:
                touching = first + (_ONE - (face & _ONE))
                store(mark_at + touching * _SIX + face, _YES)
                continue
            total += _ONE
            store(mark_at + first * _SIX + face, _YES)
            store(mark_at + (first + _ONE) * _SIX + face, _YES)
    return total


@kernel
def _link_covered(nodes, sectors, is_covered, covered, rows, table, count, first_row):
    """Make the link nodes of marked subtrees; returns how many there are now."""
    node_at, mark_at, link_at = address(nodes), address(is_covered), address(covered)
    row_at, table_at = address(rows), address(table)
    mask, end = np.uint64(len(table)) - _ONE, np.uint64(count)
    node = np.uint64(len(nodes))
    while node != _NONE:
        node -= _ONE
        axis, first, _ = split_of(node_at, node)
        plane_bits = np.uint64(load(np.uint32, node_at + node * _HALF_ROW))
        for face in range(_SIX):
            if load(np.uint8, mark_at + node * _SIX + face) != _YES:
                continue
            below = link_at + first * ROPE_BYTES + face * WORD
            above = below + ROPE_BYTES
            if axis == _LEAF:
                link = np.uint64(sectors[node]) * _ROWS
            elif face >> _ONE == axis:
                link = np.uint64(load(np.uint32, above if face & _ONE == _NONE else below))
            else:
                less = np.uint64(load(np.uint32, below))
                more = np.uint64(load(np.uint32, above))
                number, end = put_node(row_at, table_at, mask, end, plane_bits, axis, less, more)
                link = np.uint64(0x80000000) | (np.uint64(first_row) + number)
            store(link_at + node * ROPE_BYTES + face * WORD, np.uint32(link))
    return end


@kernel
def _fill_nodes(
    begin, end, base, leaves, nodes, axes, boxes, ropes, sectors, covered, firsts, raw, links
):
    """Write the raw nodes and raw links of sectors base + begin to base + end."""
    node_at, box_at, rope_at = address(nodes), address(boxes), address(ropes)
    raw_at, link_at = address(raw), address(links)
    pending = scratch(_PENDING_BYTES)
    for i in range(np.uint64(begin), np.uint64(end)):
        sector = np.uint64(base) + i
        leaf = np.uint64(leaves[sector])
        box = box_at + leaf * BOX_BYTES
        number = np.uint64(firsts[sector]) - np.uint64(firsts[base])
        for face in range(_SIX):
            rope = load(np.int32, rope_at + leaf * ROPE_BYTES + face * WORD)
            target = link_at + i * _RAW_LINKS + face * _HALF_ROW
            if rope == _NOWHERE:
                store(target, _VOID)
                continue
            store(pending, np.uint64(rope))
            store(pending + _HALF_ROW, target)
            top = pending + _PENDING
            while top != pending:
                top -= _PENDING
                node = settle(node_at, load(np.uint64, top), face, box)
                to = load(np.uint64, top + _HALF_ROW)
                if is_leaf(node_at, node):
                    store(to, np.uint64(sectors[node]) * _ROWS)
                    continue
                if _covers(box, box_at + node * BOX_BYTES, face, np.uint64(axes[node])):
                    store(to, np.uint64(covered[node, face]))
                    continue
                store(to, _RAW_BIT | number)
                to = raw_at + number * _RAW_BYTES
                number += _ONE
                _, first, _ = split_of(node_at, node)
                store(to, node)
                store(top, first)
                store(top + _HALF_ROW, to + _HALF_ROW)
                store(top + _PENDING, first + _ONE)
                store(top + _PENDING + _HALF_ROW, to + _HALF_ROW + _HALF_ROW)
                top += _PENDING + _PENDING


@kernel
def _place_links(begin, end, base, raw, links, rows):
    """Write the links of sectors base + begin to base + end, whose raw nodes have become nodes."""
    raw_at, row_at = address(raw), address(rows)
    for i in range(np.uint64(begin), np.uint64(end)):
        to = row_at + (np.uint64(base) + i) * SECTOR_BYTES + _LINKS_AT
        for face in range(_SIX):
            link = np.uint64(links[i, face])
            if link & _RAW_BIT:
                link = load(np.uint64, raw_at + (link ^ _RAW_BIT) * _RAW_BYTES)
            store(to + face * WORD, np.uint32(link))


class _Linker:
    def __init__(
        self, nodes: NDArray[np.int32], cells: Cells, order: Order, rows: NDArray[np.uint32]
    ) -> None:
        self.nodes, self.cells, self.order, self.rows = nodes, cells, order, rows
        self.store = NodeStore(SECTOR_ROWS * len(order.leaves))
        self.axes = np.empty(len(nodes), np.uint8)

    def link(self, progress: Progress | None) -> None:
        sector_count = len(self.order.leaves)
        firsts = self._count()
        begin = 0
        while begin < sector_count:
            end = int(np.searchsorted(firsts, firsts[begin] + _BATCH, "right")) - 1
            end = max(end, begin + 1)
            self._link_batch(begin, end, firsts)
            begin = end
            if progress:
                progress(begin, sector_count)

    def _count(self) -> NDArray[np.int64]:
        """Count raw nodes, and make the link nodes of covered subtrees."""
        leaves, (boxes, ropes), nodes = self.order.leaves, self.cells, self.nodes
        axes = self.axes
        _find_axes(nodes, axes)
        counts = np.empty(len(leaves), np.int64)
        is_covered = np.zeros((len(nodes), 6), np.uint8)

        def body(begin: int, end: int) -> None:
            _count_nodes(begin, end, leaves, nodes, axes, boxes, ropes, counts, is_covered)

        parallel_for(body, len(leaves), _CHUNK)
        self.covered = np.empty((len(nodes), 6), np.uint32)
        shared = self.store
        shared.reserve(int(_spread_marks(nodes, is_covered)))
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
        (leaves, sectors), (boxes, ropes), nodes = self.order, self.cells, self.nodes
        raw = np.empty((int(firsts[last] - firsts[first]), 3), np.uint64)
        links = np.empty((last - first, 6), np.uint64)
        axes, covered = self.axes, self.covered

        def fill(begin: int, end: int) -> None:
            _fill_nodes(
                begin,
                end,
                first,
                leaves,
                nodes,
                axes,
                boxes,
                ropes,
                sectors,
                covered,
                firsts,
                raw,
                links,
            )

        def place(begin: int, end: int) -> None:
            _place_links(begin, end, first, raw, links, self.rows)

        parallel_for(fill, last - first, _CHUNK)
        self.store.share(raw, nodes)
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
        The link nodes, which are to follow the sectors.

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
