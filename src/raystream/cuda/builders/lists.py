"""Triangle lists of a grid, built on the device: count, scan, fill, sort.

One thread per triangle counts the cells that it overlaps, and after a scan of the counts writes
pairs of cell and triangle from its offset. A stable sort by cell keeps the triangles of each cell
in order, as the CPU lists them.

References
----------
Kalojanov and Slusallek, "A Parallel Algorithm for Construction of Uniform Grids", High Performance
Graphics 2009.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.triangles import Triangles
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.cuda import DeviceArray, Gpu, gpu_kernel
from raystream.jit.cuda.radix_sort import sort_pairs
from raystream.jit.cuda.scan import scan_in_place
from raystream.jit.intrinsics import corners_at
from raystream.jit.simd import load, store
from raystream.structures.grid.build import TooManyError
from raystream.structures.grid.lattice import Lattice
from raystream.structures.grid.overlap import cell_ranges, each_cell


class DeviceLists(NamedTuple):
    """`structures.grid.layout.GridArrays` in device memory.

    Attributes
    ----------
    splits : DeviceArray of shape (C + 1,), uint32
    references : DeviceArray of shape (R,), int32
    """

    splits: DeviceArray
    references: DeviceArray


@device
def _visit(lattice, corners, prim_id, mark, to):
    """Call `mark` for each cell of a triangle; returns the number of cells."""
    at = corners_at(corners)
    first, last = cell_ranges(lattice, at, prim_id)
    return each_cell(lattice, at, prim_id, first, last, mark, to)


@device
def _pass(_cell, _prim_id, _rank, _to):
    pass


@device
def _note(cell, prim_id, rank, to):
    begin, cells, ids = to
    at = (begin + rank) << SHIFT_32
    store(cells + at, np.uint32(cell))
    store(ids + at, np.uint32(prim_id))


@device
def _prim_id(prim_ids, i):
    return np.uint64(load(np.int32, prim_ids + (i << SHIFT_32)))


@gpu_kernel(lattice=Lattice)
def count_cells(i, lattice, corners, prim_ids, counts):
    """Count the cells of the triangle in row i of `prim_ids`."""
    total = _visit(lattice, corners, _prim_id(prim_ids, i), _pass, ZERO_U64)
    store(counts + (i << SHIFT_64), np.uint64(total))


@gpu_kernel(lattice=Lattice)
def fill_pairs(i, lattice, corners, prim_ids, begins, cells, ids):
    """Write the cells of the triangle in row i of `prim_ids`, starting at begins[i]."""
    begin = load(np.uint64, begins + (i << SHIFT_64))
    _visit(lattice, corners, _prim_id(prim_ids, i), _note, (begin, cells, ids))


@gpu_kernel()
def find_split(i, cells, count, splits):
    """Find the first of the sorted `cells` that is not below i."""
    low, high = ZERO_U64, count
    while low < high:
        middle = (low + high) >> ONE_U64
        if np.uint64(load(np.uint32, cells + (middle << SHIFT_32))) < i:
            low = middle + ONE_U64
        else:
            high = middle
    store(splits + (i << SHIFT_32), np.uint32(low))


def build_lists(
    gpu: Gpu, triangles: Triangles, corners: DeviceArray, lattice: Lattice, most: int
) -> DeviceLists:
    """List the triangles of each cell on a device.

    Parameters
    ----------
    gpu : Gpu
    triangles : Triangles
        At least one that can be hit.
    corners : DeviceArray of shape (F, 3, 3), float32
        The triangles' corners.
    lattice : Lattice
    most : int
        Maximum number of references.

    Returns
    -------
    DeviceLists
        Equal to those of `structures.grid.build.build_lists` bit for bit.

    Raises
    ------
    TooManyError
        If there are more references.
    CudaError
        If device memory runs out: building takes 16 bytes per reference.

    Notes
    -----
    The host waits for the device once, to read the number of references.
    """
    prim_ids = gpu.upload("prim_ids", triangles.prim_ids)
    (count,) = prim_ids.shape
    begins = gpu.empty("places of references", count + 1, np.uint64)
    shared = lattice, corners, prim_ids, begins
    count_cells.launch(gpu, count, shared)
    total = scan_in_place(gpu, begins)
    if total > most:
        raise TooManyError
    cells = gpu.empty("cells of references", total, np.uint32)
    ids = gpu.empty("references", total, np.int32)
    fill_pairs.launch(gpu, count, (*shared, cells, ids))
    bits = (lattice.cell_count - 1).bit_length()
    cells, ids = sort_pairs(gpu, cells, ids, bits)
    splits = gpu.empty("splits", lattice.cell_count + 1, np.uint32)
    find_split.launch(gpu, len(splits), (cells, np.uint64(total), splits))
    return DeviceLists(splits, ids)
