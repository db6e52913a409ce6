"""The tree over a height field: lowest and highest z of blocks of cells, of blocks of those, ..."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.height_field import LocalField
from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for

__all__ = ["BLOCK_CELLS", "LEVEL", "Levels", "field_levels"]

#: Cells along each side of the smallest nodes; as many as kernels read of a row.
BLOCK_CELLS = 4

#: A level: its first node, its columns and rows of nodes, and the cells along each side of a node.
LEVEL = np.dtype([("first", "u8"), ("columns", "u8"), ("rows", "u8"), ("size", "u8")])

#: Rows of nodes per call of the kernel.
_CHUNK = 64


class Levels(NamedTuple):
    """The nodes of all levels.

    Attributes
    ----------
    ranges : ndarray of shape (M, 2), float32
        Lowest and highest z in each node, row by row, the finest level first; (inf, -inf) for a
        node without heights.
    levels : ndarray of `LEVEL`
        The last one has one node.
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
    parts = [finest]
    while parts[-1].shape[:2] != (1, 1):
        parts.append(_halved(parts[-1]))
    levels = np.zeros(len(parts), LEVEL)
    levels["rows"] = [len(one) for one in parts]
    levels["columns"] = [one.shape[1] for one in parts]
    counts = levels["rows"] * levels["columns"]
    levels["first"] = np.cumsum(counts) - counts
    levels["size"] = BLOCK_CELLS << np.arange(len(parts), dtype=np.uint64)
    return Levels(np.concatenate([one.reshape(-1, 2) for one in parts]), levels)


def _halved(ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    """The ranges of every two by two nodes."""
    rows, columns = (-(-count // 2) for count in ranges.shape[:2])
    even = np.empty((2 * rows, 2 * columns, 2), np.float32)
    even[..., 0], even[..., 1] = np.inf, -np.inf
    even[: ranges.shape[0], : ranges.shape[1]] = ranges
    four = even.reshape(rows, 2, columns, 2, 2)
    return np.stack([four[..., 0].min(axis=(1, 3)), four[..., 1].max(axis=(1, 3))], axis=-1)
