"""The cells of a lattice that list a triangle.

A hit lies near its triangle's plane and near its triangle's box (docs/decisions/0010-grid), so
these are the cells that overlap both, grown. A triangle's edges cannot be used to cull more: a
ray that lies in a triangle's plane, within rounding, may cross it beyond an edge and hit there.
A lattice that `is_exact` uses them all the same, as the papers do.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.structures.exact_overlap import edges_overlap

#: Rounding of the normal's product with an edge, as a share of the product of three edges:
#: 18 products and sums of 2**-53 each, rounded up.
_NORMAL_ERROR = 2.0**-48

#: Longer rows of cells are first clipped to the plane.
_LONG_ROW = np.int64(8)

_ZERO = np.int64(0)
_ONE = np.int64(1)


@device
def _cell_at(x, low, inverse_size, count):
    """The cell along an axis that contains x, clamped to the lattice."""
    number = math.floor((x - low) * inverse_size)
    return np.int64(min(max(number, 0.0), np.float64(count - _ONE)))


@device
def _range(a, b, c, origin, size, count, growth):
    inverse = 1.0 / size if size > 0.0 else 0.0
    low = np.float64(min(a, b, c)) - growth
    high = np.float64(max(a, b, c)) + growth
    return _cell_at(low, origin, inverse, count), _cell_at(high, origin, inverse, count)


@device
def range_along(lattice, corners, i, axis):
    """First and last cell along an axis that the grown box of a triangle overlaps.

    Parameters
    ----------
    lattice : Lattice
    corners : array of shape (F, 3, 3), float32
    i : uint64
        Row of `corners`.
    axis : int64

    Returns
    -------
    first, last : int64
    """
    a, b, c = corners[i, 0, axis], corners[i, 1, axis], corners[i, 2, axis]
    return _range(
        a, b, c, lattice.low[axis], lattice.size[axis], lattice.counts[axis], lattice.growth
    )


@device
def cell_ranges(lattice, corners, i):
    """First and last cells along all axes: a triple each; see `range_along`."""
    first_x, last_x = range_along(lattice, corners, i, 0)
    first_y, last_y = range_along(lattice, corners, i, 1)
    first_z, last_z = range_along(lattice, corners, i, 2)
    return (first_x, first_y, first_z), (last_x, last_y, last_z)


class ListWriter(NamedTuple):
    """Where the triangles of cells are counted, or written.

    Attributes
    ----------
    positions : uint64
        Address of a uint32 for each cell, which grows by one for each triangle in it.
    references : uint64
        Address of the rows, given by the positions, that triangles are written to.
    is_fill : bool
        Whether to write them.
    """

    positions: np.uint64
    references: np.uint64
    is_fill: bool


@device
def list_triangle(cell, i, _rank, writer):
    """Count or write a triangle; for `each_cell`."""
    at = writer.positions + np.uint64(4) * cell
    position = load(np.uint32, at)
    store(at, np.uint32(position + np.uint32(1)))
    if writer.is_fill:
        store(writer.references + np.uint64(4) * np.uint64(position), np.int32(i))


@device
def list_in_layers(lattice, corners, i, axis, begin, end, writer):
    """Count or write a triangle in the cells whose layers along an axis are begin to end.

    Parameters
    ----------
    lattice, corners, i, axis
        See `range_along`.
    begin, end : int64
    writer : ListWriter

    Returns
    -------
    int64
        How many cells it is in.
    """
    begin_x, end_x = (begin, end) if axis == 0 else (_ZERO, lattice.counts[0])
    begin_y, end_y = (begin, end) if axis == 1 else (_ZERO, lattice.counts[1])
    begin_z, end_z = (begin, end) if axis == 2 else (_ZERO, lattice.counts[2])
    first, last = cell_ranges(lattice, corners, i)
    first = (max(first[0], begin_x), max(first[1], begin_y), max(first[2], begin_z))
    last = (min(last[0], end_x - _ONE), min(last[1], end_y - _ONE), min(last[2], end_z - _ONE))
    return each_cell(lattice, corners, i, first, last, list_triangle, writer)


@device
def _edges_overlap(lattice, corners, i, u, place):
    """Whether a cell, grown, overlaps a triangle, given that it overlaps its box and its plane.

    The cell's place is along axes u, u + 1 and u + 2.
    """
    size, growth = lattice.size, lattice.growth
    middle_x = lattice.low[0] + size[0] * (place[(3 - u) % 3] + 0.5)
    middle_y = lattice.low[1] + size[1] * (place[(4 - u) % 3] + 0.5)
    middle_z = lattice.low[2] + size[2] * (place[(5 - u) % 3] + 0.5)
    half = (0.5 * size[0] + growth, 0.5 * size[1] + growth, 0.5 * size[2] + growth)
    a = (corners[i, 0, 0] - middle_x, corners[i, 0, 1] - middle_y, corners[i, 0, 2] - middle_z)
    b = (corners[i, 1, 0] - middle_x, corners[i, 1, 1] - middle_y, corners[i, 1, 2] - middle_z)
    c = (corners[i, 2, 0] - middle_x, corners[i, 2, 1] - middle_y, corners[i, 2, 2] - middle_z)
    return edges_overlap(a, b, c, half)


@device
def each_cell(lattice, corners, i, first, last, mark, to):
    """Call a function for each cell that a triangle is listed in.

    Parameters
    ----------
    lattice, corners, i
        See `range_along`.
    first, last : triple of int64
        Range of cells along each axis, both ends included.
    mark : device function
        ``mark(cell, i, rank, to)``: the cell's number, and the number of cells before it, uint64.
    to
        Passed to it.

    Returns
    -------
    int64
        How many cells it is in.
    """
    # Step 1: the plane, in float64 as in `kernels.triangle`.
    ax, ay = np.float64(corners[i, 0, 0]), np.float64(corners[i, 0, 1])
    az = np.float64(corners[i, 0, 2])
    px, py, pz = corners[i, 1, 0] - ax, corners[i, 1, 1] - ay, corners[i, 1, 2] - az
    qx, qy, qz = corners[i, 2, 0] - ax, corners[i, 2, 1] - ay, corners[i, 2, 2] - az
    nx = py * qz - pz * qy
    ny = pz * qx - px * qz
    nz = px * qy - py * qx

    # Step 2: a cell of half size h overlaps it if |n . (middle - a)| <= |n| . (h + growth).
    size, growth = lattice.size, lattice.growth
    reach = (
        abs(nx) * (0.5 * size[0] + growth)
        + abs(ny) * (0.5 * size[1] + growth)
        + abs(nz) * (0.5 * size[2] + growth)
    )
    # The corners themselves are off the plane by the rounding of its normal.
    p = max(abs(px), abs(py), abs(pz))
    q = max(abs(qx), abs(qy), abs(qz))
    reach += _NORMAL_ERROR * p * q * (p + q)
    # Step 3: row by row along the axis with the most cells; in a long row only where the plane
    # can be, plus a cell on either side, since the quotients are rounded.
    counts = lattice.counts
    u = 0
    if counts[1] > counts[u]:
        u = 1
    if counts[2] > counts[u]:
        u = 2
    v, w = (u + 1) % 3, (u + 2) % 3
    normal = (nx, ny, nz)
    middle = (
        lattice.low[0] + 0.5 * size[0] - ax,
        lattice.low[1] + 0.5 * size[1] - ay,
        lattice.low[2] + 0.5 * size[2] - az,
    )
    stride = (_ONE, counts[0], counts[0] * counts[1])
    slope = normal[u] * size[u]
    total = _ZERO
    for k in range(first[w], last[w] + _ONE):
        for j in range(first[v], last[v] + _ONE):
            away = (
                normal[v] * (middle[v] + size[v] * j)
                + normal[w] * (middle[w] + size[w] * k)
                + normal[u] * middle[u]
            )
            begin, end = first[u], last[u]
            if end - begin > _LONG_ROW and slope != 0.0:
                low, high = (-reach - away) / slope, (reach - away) / slope
                if low > high:
                    low, high = high, low
                begin = np.int64(min(max(low - 1.0, np.float64(begin)), np.float64(end)))
                end = np.int64(max(min(high + 1.0, np.float64(end)), np.float64(begin)))
            for m in range(begin, end + _ONE):
                if abs(away + slope * m) <= reach and (
                    not lattice.is_exact or _edges_overlap(lattice, corners, i, u, (m, j, k))
                ):
                    cell = stride[u] * m + stride[v] * j + stride[w] * k
                    mark(np.uint64(cell), i, np.uint64(total), to)
                    total += _ONE
    return total
