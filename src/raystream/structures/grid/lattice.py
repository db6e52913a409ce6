"""Lattice: the cells of a grid, and the choice of their number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.structures.grid.options import MAX_AXIS, MAX_CELLS, Grid, check_cells

#: A cell lists the triangles within this distance, relative to the scene's largest coordinate.
#: A hit lies within 1.5 paddings of its triangle's box, and a triangle's plane
#: within 1 of the hit (docs/decisions/0010-grid). The padding is `kernels.ray.PAD` of scene
#: and origin, 2**-20 each, and no origin is further away than 5 times the largest
#: coordinate: 9 units of 2**-20. The other 7 cover the rounding of planes' positions.
GROWTH = 2.0**-16

#: Added to it, for scenes so small that padding rounds to a denormal number.
_LEAST_GROWTH = 2.0**-140

#: Default cells per triangle, by number of levels.
_DENSITIES = {1: 2.0, 2: 0.25}

#: Sides of such cells are at least this many growths, so that growth does not lengthen lists.
LEAST_SIDE = 4.0


class Lattice(NamedTuple):
    """Cells of one size in a box; cell (i, j, k) is number i + counts[0] * (j + counts[1] * k).

    Plane i of an axis is at ``fma(i, size, low)``, rounded once. The first and last cell of an
    axis extend infinitely outward.

    Attributes
    ----------
    low, high, size : tuple of three float
        Low and high corner, and size of a cell: float32 numbers, local frame.
    counts : tuple of three int
        Cells along each axis. An axis on which the scene is flat has one, of size 0.
    growth : float
        Distance within which a cell lists triangles.
    is_exact : bool
        Whether it lists only triangles that come so near, not all whose box and plane do.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    size: tuple[float, float, float]
    counts: tuple[int, int, int]
    growth: float
    is_exact: bool = False

    @property
    def cell_count(self) -> int:
        """The number of cells."""
        return math.prod(self.counts)

    @property
    def box(self) -> NDArray[np.float32]:
        """Low and high corner, shape (2, 3), float32."""
        return np.array([self.low, self.high], np.float32)

    @classmethod
    def of(cls, box: NDArray[np.float32], counts: Sequence[int], is_exact: bool = False) -> Lattice:
        """Divide a box, of shape (2, 3), into cells not smaller than the growth."""
        low, high = box.astype(np.float64)
        growth = GROWTH * float(np.abs(box).max()) + _LEAST_GROWTH
        most = np.clip((high - low) / growth, 1.0, MAX_AXIS).astype(np.int64).tolist()
        nx, ny, nz = map(min, counts, most)
        x, y, z = ((high - low) / (nx, ny, nz)).astype(np.float32).tolist()
        ends = tuple(low.tolist()), tuple(high.tolist())
        return cls(*ends, (x, y, z), (nx, ny, nz), growth, is_exact)


def choose_lattice(
    triangles: Triangles,
    options: Grid,
    coarser: int = 0,
) -> Lattice:
    """Choose the cells for a scene.

    Parameters
    ----------
    triangles : Triangles
        At least one that can be hit.
    options : Grid
    coarser : int
        If they give no resolution: how many times to halve the number of cells.

    Returns
    -------
    Lattice

    Raises
    ------
    ValueError
        If there are too many cells.
    """
    if options.counts is not None:
        return Lattice.of(triangles.bounds, options.counts, options.is_exact)
    low, high = triangles.bounds.astype(np.float64)
    extent = high - low
    if options.min_resolution is not None:
        side = extent[extent > 0.0].min() / options.min_resolution
        side = max(side, GROWTH * float(triangles.max_coordinate))
        counts = _counts(extent, side)
        check_cells("min_resolution", counts)
    else:
        wanted = max(1.0, _DENSITIES[options.levels] * len(triangles.prim_ids) / 2.0**coarser)
        side = float(cube_side(extent, np.array([min(wanted, MAX_CELLS / 4)]))[0])
        side = max(side, LEAST_SIDE * GROWTH * float(triangles.max_coordinate))
        counts = _counts(extent, side)
    return Lattice.of(triangles.bounds, counts, options.is_exact)


def _counts(extent: NDArray[np.float64], side: float) -> tuple[int, ...]:
    return tuple(max(1, round(min(length / side, 2.0**40))) for length in extent.tolist())


def cube_side(extent: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    """Side of the cubes of which a given number fills a box.

    Parameters
    ----------
    extent : ndarray of shape (3,), float64
        Lengths of the box. Axes shorter than a cube count as one cube long, flat ones too.
    wanted : ndarray of shape (N,), float64
        Numbers of cubes, at least 1.

    Returns
    -------
    ndarray of shape (N,), float64
    """
    lengths = np.sort(extent[extent > 0.0])[::-1]
    # The longest axis alone, then with one axis more as long as cubes fit along that.
    # Roots are taken of each length, since a product of lengths may overflow float64.
    side = lengths[0] / wanted
    for axis in range(1, len(lengths)):
        power = 1.0 / (axis + 1)
        smaller = np.prod(lengths[: axis + 1] ** power) / wanted**power
        side = np.where(smaller <= lengths[axis], smaller, side)
    return side
