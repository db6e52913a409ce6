"""The order of sectors in memory: along a Morton curve, see `kernels.morton`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, load, store
from raystream.jit.threads import parallel_for
from raystream.kernels.morton import spread_bits
from raystream.structures.clip import BOX_BYTES, HIGH, WORD
from raystream.structures.graph.cells import NODE_BYTES, Cells, split_of
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.kdtree.layout import LEAF_AXIS, KdArrays

#: Bytes of a sector, and of the prim_ids of a block.
SECTOR_BYTES = np.uint64(16 * SECTOR_ROWS)
_BLOCK_IDS = np.uint64(16)

#: Steps of the curve along each axis: 21 bits of three axes fit into 64.
_STEPS = 1 << 21

#: Bits of a Morton code.
CODE_BITS = 63

_CHUNK = 1 << 13

_LAST_STEP = np.float64(_STEPS - 1)
_STEP_COUNT = np.float64(_STEPS)


class Order(NamedTuple):
    """The order of the sectors, which are the leaves of a kd-tree.

    Attributes
    ----------
    leaves : ndarray of shape (S,), uint32
        The node of each sector.
    sectors : ndarray of shape (M,), uint32
        The sector of each node that is a leaf.
    """

    leaves: NDArray[np.uint32]
    sectors: NDArray[np.uint32]


@device
def morton_code(whole, box):
    """The Morton code of a box's centre in a whole box, both by address."""
    code = ZERO_U64
    for axis in range(np.uint64(3)):
        at = axis * WORD
        low = np.float64(load(np.float32, whole + at))
        size = np.float64(load(np.float32, whole + HIGH + at)) - low
        middle = np.float64(load(np.float32, box + at)) + load(np.float32, box + HIGH + at)
        place = (middle * 0.5 - low) / size * _STEP_COUNT
        code |= spread_bits(np.uint64(min(max(place, 0.0), _LAST_STEP))) << axis
    return code


@kernel
def _find_codes(begin, end, leaves, boxes, codes):
    """Write the Morton codes of the centres of leaves begin to end."""
    box_at = address(boxes)
    for i in range(np.uint64(begin), np.uint64(end)):
        codes[i] = morton_code(box_at, box_at + np.uint64(leaves[i]) * BOX_BYTES)


def order_sectors(nodes: NDArray[np.int32], cells: Cells) -> Order:
    """Number the leaves of a tree along a Morton curve through their centres.

    Parameters
    ----------
    nodes : ndarray of shape (M, 2), int32
    cells : Cells

    Returns
    -------
    Order
        Leaves with the same code are in the order of the tree's nodes.
    """
    leaves = np.flatnonzero(nodes[:, 1] & 3 == LEAF_AXIS).astype(np.uint32)
    codes = np.empty(len(leaves), np.uint64)

    def body(begin: int, end: int) -> None:
        _find_codes(begin, end, leaves, cells.boxes, codes)

    parallel_for(body, len(leaves), _CHUNK)
    leaves = leaves[np.argsort(codes, kind="stable")]
    sectors = np.zeros(len(nodes), np.uint32)
    sectors[leaves] = np.arange(len(leaves), dtype=np.uint32)
    return Order(leaves, sectors)


@device
def fill_sector(to, box, first, count):
    """Write a sector except for its links: box, first block, number of triangles."""
    for axis in range(np.uint64(3)):
        at = axis * WORD
        store(to + at, load(np.float32, box + at))
        store(to + np.uint64(16) + at, load(np.float32, box + HIGH + at))
    store(to + np.uint64(12), np.uint32(first))
    store(to + np.uint64(28), np.uint32(count))
    store(to + np.uint64(56), ZERO_U64)  # the unused words


@kernel
def _fill_sectors(begin, end, leaves, nodes, boxes, tree_ids, firsts, rows, prim_ids):
    """Write the boxes and triangles of sectors begin to end."""
    node_at, box_at, tree_at = address(nodes), address(boxes), address(tree_ids)
    row_at, id_at = address(rows), address(prim_ids)
    for sector in range(np.uint64(begin), np.uint64(end)):
        leaf = np.uint64(leaves[sector])
        _, count, _ = split_of(node_at, leaf)
        first, last = np.uint64(firsts[sector]), np.uint64(firsts[sector + ONE_U64])
        fill_sector(row_at + sector * SECTOR_BYTES, box_at + leaf * BOX_BYTES, first, count)
        source = tree_at + np.uint64(load(np.uint32, node_at + leaf * NODE_BYTES)) * _BLOCK_IDS
        for k in range((last - first) * np.uint64(4)):
            prim_id = load(np.int32, source + k * WORD)
            store(id_at + first * _BLOCK_IDS + k * WORD, prim_id)


def fill_sectors(
    tree: KdArrays, cells: Cells, order: Order, rows: NDArray[np.uint32]
) -> NDArray[np.int32]:
    """Write the sectors except for their links.

    Parameters
    ----------
    tree : KdArrays
    cells : Cells
    order : Order
    rows : ndarray of shape (R, 4), uint32
        Written: the sectors' rows.

    Returns
    -------
    ndarray of shape (B, 4), int32
        `layout.GraphArrays.prim_ids`, in the order of the sectors.
    """
    leaves = order.leaves
    counts = tree.nodes[leaves, 1] >> 2
    firsts = np.zeros(len(leaves) + 1, np.int64)
    np.cumsum((counts + 3) // 4, out=firsts[1:])
    prim_ids = np.empty((int(firsts[-1]), 4), np.int32)

    def body(begin: int, end: int) -> None:
        _fill_sectors(
            begin, end, leaves, tree.nodes, cells.boxes, tree.prim_ids, firsts, rows, prim_ids
        )

    parallel_for(body, len(leaves), _CHUNK)
    return prim_ids
