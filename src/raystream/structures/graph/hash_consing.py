"""Sharing equal link nodes among faces, by hash-consing.

Nodes are looked up in a hash table by their content, so that equal trees become the same tree
(Ershov, "On programming of arithmetic operations", Communications of the ACM 1(8),
1958). Nodes are numbered in the order in which they are first added, after those that they link to.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.jit.constants import BYTES_32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, load, store
from raystream.structures.graph.layout import MAX_ROWS, NODE_BIT, NODE_WORDS

#: This bit of a raw link (uint64) marks the number of a raw node; without it, it is a link.
RAW = 1 << 32

_LEAST_ROOM = 1 << 10

_RAW_BIT = np.uint64(RAW)
_NODE_LINK = np.uint64(NODE_BIT)
_HALF_ROW = np.uint64(8)
_ROW = np.uint64(16)
_RAW_BYTES = np.uint64(24)
_FREE = np.uint32(0xFFFFFFFF)


@device
def first_slot(one, other, mask):
    """The hash of a link node of two words: its first slot in a table."""
    mixed = (one ^ (one >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ other) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)
    return (mixed ^ (mixed >> np.uint64(29))) & mask


@device
def put_node(rows, table, mask, count, plane_bits, axis, below, above):
    """Look up a link node, and add it if it is new.

    Parameters
    ----------
    rows : uint64
        Address of the nodes, with room for one more.
    table : uint64
        Address of the table: node numbers at the slot of their hash or the next free one.
    mask : uint64
        Number of slots less 1; more than half of them are free.
    count : uint64
        Nodes so far.
    plane_bits, axis : uint64
    below, above : uint64
        Links.

    Returns
    -------
    number : uint64
        Of the node.
    count : uint64
        Nodes now.
    """
    one, other = plane_bits | axis << np.uint64(32), below | above << np.uint64(32)
    slot = first_slot(one, other, mask)
    while True:
        found = load(np.uint32, table + slot * BYTES_32)
        if found == _FREE:
            store(table + slot * BYTES_32, np.uint32(count))
            store(rows + count * _ROW, one)
            store(rows + count * _ROW + _HALF_ROW, other)
            return count, count + ONE_U64
        at = rows + np.uint64(found) * _ROW
        if load(np.uint64, at) == one and load(np.uint64, at + _HALF_ROW) == other:
            return np.uint64(found), count
        slot = (slot + ONE_U64) & mask


@kernel
def _fill_table(rows, count, table):
    """Insert distinct nodes into an empty table."""
    row_at, table_at, mask = address(rows), address(table), np.uint64(len(table)) - ONE_U64
    for number in range(np.uint64(count)):
        at = row_at + number * _ROW
        slot = first_slot(load(np.uint64, at), load(np.uint64, at + _HALF_ROW), mask)
        while load(np.uint32, table_at + slot * BYTES_32) != _FREE:
            slot = (slot + ONE_U64) & mask
        store(table_at + slot * BYTES_32, np.uint32(number))


@device
def _resolved(raw, link):
    """The link that replaces a raw link."""
    if link & _RAW_BIT:
        return load(np.uint64, raw + (link ^ _RAW_BIT) * _RAW_BYTES)
    return link


@kernel
def _share(raw, tree, rows, table, count, first_row):
    """Add raw nodes, in reverse order; the first word of each becomes its link."""
    raw_at, tree_at, row_at, table_at = address(raw), address(tree), address(rows), address(table)
    mask, end = np.uint64(len(table)) - ONE_U64, np.uint64(count)
    left = np.uint64(len(raw))
    while left != ZERO_U64:
        left -= ONE_U64
        at = raw_at + left * _RAW_BYTES
        split = tree_at + load(np.uint64, at) * _HALF_ROW
        below = _resolved(raw_at, load(np.uint64, at + _HALF_ROW))
        above = _resolved(raw_at, load(np.uint64, at + _ROW))
        plane_bits = np.uint64(load(np.uint32, split))
        axis = np.uint64(load(np.uint32, split + BYTES_32)) & np.uint64(3)
        number, end = put_node(row_at, table_at, mask, end, plane_bits, axis, below, above)
        store(at, _NODE_LINK | (np.uint64(first_row) + number))
    return end


class NodeStore:
    """The link nodes of a graph during the build.

    Parameters
    ----------
    first_row : int
        The row of the first node.
    """

    def __init__(self, first_row: int) -> None:
        self.first_row = first_row
        self.count = 0
        self.rows = np.empty((0, NODE_WORDS), np.uint32)
        self.table = np.empty(0, np.uint32)

    def reserve(self, count: int) -> None:
        """Make room for more nodes.

        Raises
        ------
        ValueError
            If there are too many for links.
        MemoryError
            If there is not enough memory.
        """
        wanted = self.count + count
        if self.first_row + wanted > MAX_ROWS:
            raise ValueError(f"a graph of {wanted:,} link nodes is too large")
        if wanted <= len(self.rows):
            return
        room = max(_LEAST_ROOM, wanted, 2 * len(self.rows))
        slots = 1 << (2 * room - 1).bit_length()
        check_memory(16 * room + 4 * slots, f"{room:,} link nodes would")
        rows = np.empty((room, NODE_WORDS), np.uint32)
        rows[: self.count] = self.rows[: self.count]
        self.rows = rows
        self.table = np.full(slots, 0xFFFFFFFF, np.uint32)
        _fill_table(self.rows, self.count, self.table)

    def share(self, raw: NDArray[np.uint64], tree: NDArray[np.int32]) -> None:
        """Add raw nodes.

        Parameters
        ----------
        raw : ndarray of shape (N, 3), uint64
            The kd-tree's node of a raw node, and its raw links. Raw nodes come before
            those that they link to. Written: in the first column, the links to them.
        tree : ndarray of shape (M, 2), int32
        """
        self.reserve(len(raw))
        first_row = self.first_row
        self.count = int(_share(raw, tree, self.rows, self.table, self.count, first_row))
