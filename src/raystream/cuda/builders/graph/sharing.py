"""Deduplication of link nodes in a hash table, with a result that does not depend on timing.

Nodes that may be equal (candidates) are numbered in the CPU's order. They enter the table in
rounds, after the nodes that they link to. The slot that equal candidates share, which stands for
them during linking, depends on the order of threads; the lowest of their numbers does not, and
gives the order of the final rows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.atomics import atomic_max, compare_and_swap
from raystream.jit.constants import BITS_32, BYTES_64, LOW_32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.scan import scan_in_place
from raystream.jit.simd import load, store
from raystream.structures.clip import WORD
from raystream.structures.graph.hash_consing import first_slot
from raystream.structures.graph.layout import MAX_ROWS, NODE_BIT

#: During linking, this bit marks a link whose other bits are a slot of the table.
LINK = np.uint64(NODE_BIT)

_ROW = np.uint64(16)
_FREE = np.uint32(0)


class LinkTable(NamedTuple):
    """A hash table of C candidates for link nodes, on a device.

    Attributes
    ----------
    contents : DeviceArray of shape (C, 2), uint64
        The two words of each candidate; see `GraphArrays.rows`.
    owners : DeviceArray of shape (S,), uint32
        For each slot the candidate that claimed it, plus 1, or 0. S is a power of two; at least
        half of the slots stay free.
    leasts : DeviceArray of shape (S,), uint32
        The complement of the least candidate of each slot.
    ranks : DeviceArray of shape (C + 1,), uint32
        The number of distinct nodes before each candidate.
    mask : uint64
        S - 1.
    first_row : uint64
        Row of the first link node in the graph.
    """

    contents: DeviceArray
    owners: DeviceArray
    leasts: DeviceArray
    ranks: DeviceArray
    mask: np.uint64
    first_row: np.uint64

    @classmethod
    def empty(cls, gpu: Gpu, candidate_count: int, first_row: int) -> LinkTable:
        """Allocate a table whose slots are free.

        Raises
        ------
        ValueError
            If there are more rows than links can address.
        CudaError
            If device memory runs out: it takes 28 to 36 bytes per candidate.
        """
        if first_row + candidate_count > MAX_ROWS or candidate_count > 1 << 29:
            raise ValueError(f"a graph of {candidate_count:,} link nodes is too large")
        slot_count = 1 << (2 * candidate_count).bit_length()
        return cls(
            gpu.empty("link nodes", (candidate_count, 2), np.uint64),
            gpu.zeros("table of link nodes", slot_count, np.uint32),
            gpu.zeros("least link nodes", slot_count, np.uint32),
            gpu.zeros("ranks of link nodes", candidate_count + 1, np.uint32),
            np.uint64(slot_count - 1),
            np.uint64(first_row),
        )

    def rank(self, gpu: Gpu) -> int:
        """Assign rows to the nodes once all candidates are in; returns the number of nodes."""
        mark_first.launch(gpu, len(self.owners), (self,))
        return scan_in_place(gpu, self.ranks)

    def write(self, gpu: Gpu, rows: DeviceArray) -> None:
        """Launch the kernel that writes the link nodes to the rows of a graph."""
        write_link_node.launch(gpu, len(self.owners), (self, rows))


@device
def put_candidate(table, candidate, plane_bits, axis, below, above):
    """Write a candidate's content."""
    to = table.contents + candidate * _ROW
    store(to, plane_bits | axis << BITS_32)
    store(to + BYTES_64, below | above << BITS_32)


@device
def _content(table, candidate):
    at = table.contents + candidate * _ROW
    return load(np.uint64, at), load(np.uint64, at + BYTES_64)


@device
def share_slot(table, candidate):
    """Find the slot of a candidate whose content an earlier kernel wrote."""
    one, other = _content(table, candidate)
    slot = first_slot(one, other, table.mask)
    while True:
        at = table.owners + slot * WORD
        owner = load(np.uint32, at)
        if owner == _FREE:
            owner = compare_and_swap(at, _FREE, np.uint32(candidate + ONE_U64))
        is_own = owner == _FREE
        if not is_own:
            found, found_other = _content(table, np.uint64(owner) - ONE_U64)
            is_own = found == one and found_other == other
        if is_own:
            atomic_max(table.leasts + slot * WORD, np.uint32(candidate ^ LOW_32))
            return slot
        slot = (slot + ONE_U64) & table.mask


@device
def _least(table, slot):
    return np.uint64(load(np.uint32, table.leasts + slot * WORD)) ^ LOW_32


@gpu_kernel(table=LinkTable)
def mark_first(slot, table):
    """Mark the first candidate of a slot."""
    if load(np.uint32, table.owners + slot * WORD) != _FREE:
        store(table.ranks + _least(table, slot) * WORD, np.uint32(1))


@device
def final_link(table, link):
    """Convert a link to a slot into one to a row; other links and `VOID` are unchanged."""
    if link & LINK == ZERO_U64 or link == LOW_32:
        return link
    least = _least(table, link ^ LINK)
    rank = np.uint64(load(np.uint32, table.ranks + least * WORD))
    return LINK | (table.first_row + rank)


@gpu_kernel(table=LinkTable)
def write_link_node(slot, table, rows):
    """Write the link node of a slot."""
    owner = np.uint64(load(np.uint32, table.owners + slot * WORD))
    if owner == ZERO_U64:
        return
    one, other = _content(table, owner - ONE_U64)
    below, above = final_link(table, other & LOW_32), final_link(table, other >> BITS_32)
    to = rows + (final_link(table, LINK | slot) ^ LINK) * _ROW
    store(to, one)
    store(to + BYTES_64, below | above << BITS_32)
