"""Kernels that link sectors, launched by `linker`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.builders.graph.sharing import (
    LINK,
    LinkTable,
    final_link,
    put_candidate,
    share_slot,
)
from raystream.jit.atomics import atomic_max
from raystream.jit.constants import BYTES_64, INF_F32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, gpu_kernel
from raystream.jit.simd import load, scratch, store
from raystream.structures.clip import WORD
from raystream.structures.graph.cells import NODE_BYTES, ROPE_BYTES, split_of
from raystream.structures.graph.face_subtrees import (
    PENDING_BYTES,
    RopeTree,
    count_raw_nodes,
    find_axes,
    propagate_marks,
    write_raw_nodes,
)
from raystream.structures.graph.hash_consing import RAW
from raystream.structures.graph.layout import SECTOR_ROWS, VOID
from raystream.structures.graph.links import LINKS_AT, RAW_LINKS
from raystream.structures.graph.morton_order import SECTOR_BYTES
from raystream.structures.kdtree.layout import LEAF_AXIS

_SIX = np.uint64(6)
_ROW = np.uint64(16)
_RAW_BYTES = np.uint64(24)
_RAW_BIT = np.uint64(RAW)
_ROWS = np.uint64(SECTOR_ROWS)
_VOID = np.uint64(VOID)
_LEAF = np.uint64(LEAF_AXIS)
_YES = np.uint8(1)


class Raw(NamedTuple):
    """Raw nodes, on a device.

    Attributes
    ----------
    nodes : DeviceArray of shape (R, 3), uint64
        The node of the tree, later replaced by the link to it, and its raw links.
    heights : DeviceArray of shape (R,), uint8
        1 if it links to no raw node, else 1 more than the highest of them.
    tops : DeviceArray of shape (1,), uint32
        The greatest height.
    ends : DeviceArray of uint64
        The ends of the CPU's batches.
    first : uint64
        The first candidate among them.
    """

    nodes: DeviceArray
    heights: DeviceArray
    tops: DeviceArray
    ends: DeviceArray
    first: np.uint64


class CandidateOrder(NamedTuple):
    """The CPU's order of the link nodes of covered subtrees.

    Attributes
    ----------
    rows : DeviceArray of shape (M,), uint32
        The nodes' rows.
    row_count : uint64
    before : DeviceArray of shape (6 * row_count + 1,), uint32
        The number of link nodes before each row and face.
    """

    rows: DeviceArray
    row_count: np.uint64
    before: DeviceArray


@device
def _leaf_of(leaves, sector):
    return np.uint64(load(np.uint32, leaves + sector * WORD))


@device
def _is_marked(is_covered, node, face):
    return load(np.uint8, is_covered + node * _SIX + face) == _YES


@gpu_kernel()
def find_node_axes(i, first, nodes, axes):
    """Find the axes of the splits below node first + i, whose children are done."""
    find_axes(nodes, first + i, axes)


@gpu_kernel(tree=RopeTree)
def count_raw(sector, leaves, tree, is_covered, counts):
    """Count the raw nodes of a sector, and mark subtrees that a face covers."""
    pending = scratch(PENDING_BYTES)
    count = count_raw_nodes(_leaf_of(leaves, sector), tree, is_covered, pending)
    store(counts + sector * BYTES_64, np.uint64(count))


@gpu_kernel()
def spread_covered(i, first, nodes, is_covered):
    """Mark the subtrees that the link nodes of node first + i need, if it is covered."""
    propagate_marks(nodes, first + i, is_covered)


@device
def _makes_node(nodes, node, face, is_covered):
    """Whether a covered subtree has a link node of its own."""
    axis, _, _ = split_of(nodes, node)
    return axis != _LEAF and axis != face >> ONE_U64 and _is_marked(is_covered, node, face)


@gpu_kernel()
def mark_covered(i, nodes, by_row, row_count, is_covered, marks):
    """Mark link nodes in the CPU's order: last rows first, six faces per row."""
    row = row_count - ONE_U64 - i // _SIX
    node = np.uint64(load(np.uint32, by_row + row * WORD))
    found = _makes_node(nodes, node, i % _SIX, is_covered)
    store(marks + i * WORD, np.uint32(ONE_U64 if found else ZERO_U64))


@device
def _candidate(node, face, order):
    row = np.uint64(load(np.uint32, order.rows + node * WORD))
    at = (order.row_count - ONE_U64 - row) * _SIX + face
    return np.uint64(load(np.uint32, order.before + at * WORD))


@gpu_kernel(order=CandidateOrder, table=LinkTable)
def put_covered(i, first, nodes, sectors, is_covered, order, covered, table):
    """Write the links to node first + i, or the contents of link nodes that it needs."""
    node = first + i
    axis, child, _ = split_of(nodes, node)
    plane_bits = np.uint64(load(np.uint32, nodes + node * NODE_BYTES))
    for face in range(_SIX):
        if not _is_marked(is_covered, node, face):
            continue
        to = covered + node * ROPE_BYTES + face * WORD
        below = covered + child * ROPE_BYTES + face * WORD
        above = below + ROPE_BYTES
        if axis == _LEAF:
            sector = np.uint64(load(np.uint32, sectors + node * WORD))
            store(to, np.uint32(sector * _ROWS))
        elif face >> ONE_U64 == axis:  # only the child at this face is beside it
            store(to, load(np.uint32, above if face & ONE_U64 == ZERO_U64 else below))
        else:
            candidate = _candidate(node, face, order)
            less, more = np.uint64(load(np.uint32, below)), np.uint64(load(np.uint32, above))
            put_candidate(table, candidate, plane_bits, axis, less, more)


@gpu_kernel(order=CandidateOrder, table=LinkTable)
def share_covered(i, first, nodes, is_covered, order, covered, table):
    """Find the slots of the link nodes of node first + i."""
    node = first + i
    for face in range(_SIX):
        if _makes_node(nodes, node, face, is_covered):
            slot = share_slot(table, _candidate(node, face, order))
            store(covered + node * ROPE_BYTES + face * WORD, np.uint32(LINK | slot))


@device
def _height(raw, link):
    if link & _RAW_BIT == ZERO_U64:
        return ZERO_U64
    return np.uint64(load(np.uint8, raw.heights + (link ^ _RAW_BIT)))


@gpu_kernel(tree=RopeTree, raw=Raw)
def fill_raw(sector, leaves, tree, sectors, covered, firsts, raw, links):
    """Write the raw nodes of a sector, their heights, and its raw links."""
    pending = scratch(PENDING_BYTES)
    at = firsts + sector * BYTES_64
    first, number = load(np.uint64, at), load(np.uint64, at + BYTES_64)
    leaf, to = _leaf_of(leaves, sector), links + sector * RAW_LINKS
    write_raw_nodes(leaf, tree, sectors, covered, first, raw.nodes, to, pending)
    # Links lead to later nodes, so heights are found from the last node on.
    highest = ZERO_U64
    while number != first:
        number -= ONE_U64
        node = raw.nodes + number * _RAW_BYTES
        below, above = load(np.uint64, node + BYTES_64), load(np.uint64, node + _ROW)
        height = max(_height(raw, below), _height(raw, above)) + ONE_U64
        store(raw.heights + number, np.uint8(height))
        highest = max(highest, height)
    atomic_max(raw.tops, np.uint32(highest))


@device
def _raw_candidate(raw, i):
    """The candidate of raw node i: batches are in sector order, each numbered from its end."""
    begin, at = ZERO_U64, raw.ends
    while load(np.uint64, at) <= i:
        begin = load(np.uint64, at)
        at += BYTES_64
    return raw.first + begin + load(np.uint64, at) - ONE_U64 - i


@device
def _resolved(raw, link):
    if link & _RAW_BIT:
        return load(np.uint64, raw.nodes + (link ^ _RAW_BIT) * _RAW_BYTES)
    return link


@gpu_kernel(raw=Raw, table=LinkTable)
def put_raw(i, height, nodes, raw, table):
    """Write the content of raw node i, if it has this height."""
    if np.uint64(load(np.uint8, raw.heights + i)) != height:
        return
    at = raw.nodes + i * _RAW_BYTES
    node = load(np.uint64, at)
    axis, _, _ = split_of(nodes, node)
    plane_bits = np.uint64(load(np.uint32, nodes + node * NODE_BYTES))
    below = _resolved(raw, load(np.uint64, at + BYTES_64))
    above = _resolved(raw, load(np.uint64, at + _ROW))
    put_candidate(table, _raw_candidate(raw, i), plane_bits, axis, below, above)


@gpu_kernel(raw=Raw, table=LinkTable)
def share_raw(i, height, raw, table):
    """Find the slot of raw node i, if it has this height."""
    if np.uint64(load(np.uint8, raw.heights + i)) == height:
        slot = share_slot(table, _raw_candidate(raw, i))
        store(raw.nodes + i * _RAW_BYTES, LINK | slot)


@gpu_kernel(raw=Raw, table=LinkTable)
def place_links(sector, links, raw, table, rows):
    """Write a sector's links; planes with no sector behind them move to infinity."""
    row = rows + sector * SECTOR_BYTES
    for face in range(_SIX):
        link = _resolved(raw, load(np.uint64, links + sector * RAW_LINKS + face * BYTES_64))
        store(row + LINKS_AT + face * WORD, np.uint32(final_link(table, link)))
        if link == _VOID:
            plane = row + (face >> ONE_U64) * WORD
            if face & ONE_U64 == ZERO_U64:
                store(plane, -INF_F32)
            else:
                store(plane + _ROW, INF_F32)
