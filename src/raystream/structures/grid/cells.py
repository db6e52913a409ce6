"""The lattices of a grid in kernels: the coarse one, and those within its cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import NULL, SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import fma, load

#: `child_of` a cell that is not subdivided.
NO_CHILD = np.int32(-1)


#: Bytes of a row of `FineArrays.records`.
_RECORD = np.uint64(32)


class LatticeView(NamedTuple):
    """A lattice for walks, with the addresses of its lists.

    Attributes
    ----------
    low, size, counts : triple of float32
        See `dda.begin_walk`.
    splits, references : uint64
        Addresses of `GridArrays`.
    """

    low: object
    size: object
    counts: object
    splits: object
    references: object


@device
def coarse_cells(grid):
    """The first level of a grid, given as `GridAddresses`."""
    return LatticeView(grid.low, grid.size, grid.counts, grid.splits, grid.references)


@device
def cell_numbers(grid, cell):
    """Indices of a coarse cell along the axes, as float32."""
    nx, ny = np.int64(grid.counts[0]), np.int64(grid.counts[1])
    rest = np.int64(cell)
    return np.float32(rest % nx), np.float32(rest // nx % ny), np.float32(rest // (nx * ny))


@device
def child_of(grid, cell):
    """Number of the lattice within a coarse cell; `NO_CHILD` if it is not subdivided."""
    if grid.children == NULL:
        return NO_CHILD
    return load(np.int32, grid.children + (np.uint64(cell) << SHIFT_32))


@device
def fine_cells(grid, cell, child):
    """The lattice within a coarse cell."""
    record = grid.records + np.uint64(child) * _RECORD
    first = load(np.int64, record)
    counts = (
        np.float32(load(np.int64, record + np.uint64(8))),
        np.float32(load(np.int64, record + np.uint64(16))),
        np.float32(load(np.int64, record + np.uint64(24))),
    )
    i, j, k = cell_numbers(grid, cell)
    low = (
        fma(i, grid.size[0], grid.low[0]),
        fma(j, grid.size[1], grid.low[1]),
        fma(k, grid.size[2], grid.low[2]),
    )
    size = (grid.size[0] / counts[0], grid.size[1] / counts[1], grid.size[2] / counts[2])
    splits = grid.fine_splits + (np.uint64(first) << SHIFT_32)
    return LatticeView(low, size, counts, splits, grid.fine_references)


@device
def cell_list(splits, cell):
    """Begin and end of the list of a cell, given the address of all splits."""
    at = splits + (np.uint64(cell) << SHIFT_32)
    return np.uint64(load(np.uint32, at)), np.uint64(load(np.uint32, at + np.uint64(4)))
