"""The tree over a height field: lowest and highest z of blocks of cells, of blocks of those, ..."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.height_field import LocalField
from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for

#: Cells along each side of the smallest nodes; as many as kernels read of a row.
BLOCK_CELLS = 4

#: A level: its first group of four nodes, the groups in a row of them, and the cells along each
#: side of a node.
LEVEL = np.dtype([("first", "u8"), ("columns", "u8"), ("size", "u8")])

#: Rows of nodes per call of the kernel.
_CHUNK = 64


class Levels(NamedTuple):
    """The nodes of all levels.

    Attributes
    ----------
    ranges : ndarray of shape (M, 2, 4), float32
        Lowest and highest z in every two by two nodes, the children of a node of the level above,
        whose rows follow each other: lower row and column first. The finest level is first; above
        the last one is the root alone. (inf, -inf) for nodes without heights, or beyond the end.
    levels : ndarray of `LEVEL`
        Of these groups of four; the last level has one.
    """

    ranges: NDArray[np.float32]
    levels: NDArray[np.void]


@kernel
def _find_ranges(begin, end, heights, ranges):
    """Find the ranges of the rows begin to end of the finest nodes.

    Parameters
    ----------
    begin, end : int
    heights : ndarray of shape (H, W), float32
    ranges : ndarray of shape (rows, columns, 2), float32
    """
    last_row, last_column = heights.shape[0] - 1, heights.shape[1] - 1
    for j in range(begin, end):
        row_end = min((j + 1) * BLOCK_CELLS, last_row) + 1
        for i in range(ranges.shape[1]):
            column_end = min((i + 1) * BLOCK_CELLS, last_column) + 1
            low, high = np.float32(np.inf), np.float32(-np.inf)
            for row in range(j * BLOCK_CELLS, row_end):
                for column in range(i * BLOCK_CELLS, column_end):
                    height = heights[row, column]
                    if height < low:  # never of a NaN
                        low = height
                    if height > high:
                        high = height
            ranges[j, i, 0], ranges[j, i, 1] = low, high


def field_levels(field: LocalField) -> Levels:
    """Build the tree, on all threads."""
    row_count, column_count = len(field.y), len(field.x) - BLOCK_CELLS
    heights = field.heights[: row_count * column_count].reshape(row_count, column_count)
    rows = -(-(row_count - 1) // BLOCK_CELLS)
    columns = -(-(column_count - 1) // BLOCK_CELLS)
    finest = np.empty((rows, columns, 2), np.float32)
    parallel_for(lambda begin, end: _find_ranges(begin, end, heights, finest), rows, _CHUNK)
    groups: list[NDArray[np.float32]] = []
    nodes = finest
    while not groups or nodes.shape[:2] != (1, 1):
        groups.append(_grouped(nodes))
        nodes = np.stack([groups[-1][:, :, 0].min(axis=-1), groups[-1][:, :, 1].max(axis=-1)], -1)
    levels = np.zeros(len(groups), LEVEL)
    levels["columns"] = [one.shape[1] for one in groups]
    counts = [one.shape[0] * one.shape[1] for one in groups]
    levels["first"] = np.cumsum(counts) - counts
    levels["size"] = BLOCK_CELLS << np.arange(len(groups), dtype=np.uint64)
    return Levels(np.concatenate([one.reshape(-1, 2, 4) for one in groups]), levels)


def _grouped(nodes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Every two by two nodes of a level: shape (rows, columns, 2) gives (rows, columns, 2, 4)."""
    rows, columns = (-(-count // 2) for count in nodes.shape[:2])
    even = np.empty((2 * rows, 2 * columns, 2), np.float32)
    even[..., 0], even[..., 1] = np.inf, -np.inf
    even[: nodes.shape[0], : nodes.shape[1]] = nodes
    four = even.reshape(rows, 2, columns, 2, 2).transpose(0, 2, 4, 1, 3)
    return np.ascontiguousarray(four).reshape(rows, columns, 2, 4)
