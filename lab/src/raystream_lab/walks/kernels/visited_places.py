"""The number of the cell or node that a ray's step visits."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.structures.grid.cells import child_of

_COARSE = np.int32(-1)
_RECORD = np.uint64(32)


@device
def cell_of(tree, place):
    """The cell that a step through a grid visits; inner cells follow the others."""
    if place.outer == _COARSE:
        return np.uint32(place.cell)
    child = np.uint64(child_of(tree, place.outer))
    first = np.uint64(load(np.int64, tree.records + child * _RECORD))
    nx, ny, nz = np.uint64(tree.counts[0]), np.uint64(tree.counts[1]), np.uint64(tree.counts[2])
    return np.uint32(nx * ny * nz + first + np.uint64(place.cell))


@device
def node_of(tree, place):  # noqa: ARG001 - as `cell_of`
    """The kd-tree node at which a step begins."""
    return np.uint32(place.node)
