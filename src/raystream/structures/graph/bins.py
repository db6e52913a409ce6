"""The bins of a graph: a nearby sector for each part of the scene's box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address
from raystream.jit.threads import parallel_for
from raystream.structures.graph.cells import split_of
from raystream.structures.graph.layout import SECTOR_ROWS
from raystream.structures.graph.morton_order import Order
from raystream.structures.kdtree.layout import LEAF_AXIS

#: Minimum and maximum number of bins along an axis.
_FEWEST, _MOST = 16, 256

_CHUNK = 1 << 12

_LEAF = np.uint64(LEAF_AXIS)
_ROWS = np.uint64(SECTOR_ROWS)


def choose_bin_counts(sector_count: int, box: NDArray[np.float32]) -> tuple[int, int, int]:
    """Bins along each axis: one per three sectors, unless the box is flat.

    More bins shorten walks but take more cache misses: in a graph of 216,000 sectors,
    six times as many made random rays a sixth slower.

    Parameters
    ----------
    sector_count : int
    box : ndarray of shape (2, 3), float32

    Returns
    -------
    tuple of three int
        1 along an axis on which the box is thinner than a bin of its longest axis.
    """
    count = min(max(round((sector_count / 3) ** (1 / 3)), _FEWEST), _MOST)
    low, high = box.astype(np.float64)
    is_flat = (high - low) * count < (high - low).max()
    x, y, z = np.where(is_flat, 1, count).tolist()
    return x, y, z


def bin_corners(
    box: NDArray[np.float32], counts: tuple[int, int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Low sides of the bins along each axis: ``low + i * ((high - low) / count)``, all float32."""
    low, high = box
    x, y, z = (
        low[k]
        + np.arange(counts[k], dtype=np.float32) * ((high[k] - low[k]) / np.float32(counts[k]))
        for k in range(3)
    )
    return x, y, z


@device
def leaf_at(nodes, x, y, z):
    """The leaf of a tree that contains a point; on a plane, the one above."""
    node = ZERO_U64
    axis, first, plane = split_of(nodes, node)
    while axis != _LEAF:
        place = x if axis == ZERO_U64 else (y if axis == ONE_U64 else z)
        node = first if place < plane else first + ONE_U64
        axis, first, plane = split_of(nodes, node)
    return node


@kernel
def _fill_bins(begin, end, nodes, sectors, x, y, z, bins):
    """Locate the corners of bins begin to end, z first."""
    node_at = address(nodes)
    for row in range(np.uint64(begin), np.uint64(end)):
        yz = row // np.uint64(len(z))
        px, py = x[yz // np.uint64(len(y))], y[yz % np.uint64(len(y))]
        node = leaf_at(node_at, px, py, z[row % np.uint64(len(z))])
        bins[row] = np.uint64(sectors[node]) * _ROWS


def fill_bins(
    nodes: NDArray[np.int32], order: Order, box: NDArray[np.float32]
) -> NDArray[np.uint32]:
    """Find the sectors that contain the bins' low corners.

    Parameters
    ----------
    nodes : ndarray of shape (M, 2), int32
        The kd-tree.
    order : Order
    box : ndarray of shape (2, 3), float32
        The box of all sectors.

    Returns
    -------
    ndarray of shape (X, Y, Z), uint32
        `layout.GraphArrays.bins`. A corner on a plane belongs to the sector above it.
    """
    counts = choose_bin_counts(len(order.leaves), box)
    x, y, z = bin_corners(box, counts)
    bins = np.empty(counts, np.uint32)
    flat = bins.reshape(-1)

    def body(begin: int, end: int) -> None:
        _fill_bins(begin, end, nodes, order.sectors, x, y, z, flat)

    parallel_for(body, len(flat), _CHUNK)
    return bins
