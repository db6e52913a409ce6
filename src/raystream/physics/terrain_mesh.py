"""Triangles over elevation rasters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.physics.elevation import Elevation

#: Walls end this part of the terrain's size below the lowest ground, where no line of sight passes.
_DEPTH = 2.0**-10


def triangulated(elevation: Elevation) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Two triangles for each square of four neighbouring cells, front faces upward.

    Parameters
    ----------
    elevation : Elevation

    Returns
    -------
    vertices : ndarray of shape (H * W, 3), float64
        The centres of all cells, row by row; z is NaN where there is no data.
    faces : ndarray of shape (F, 3), int32
        Without triangles that have a corner without data. Neighbours share vertices.
    """
    heights = elevation.heights
    row_count, column_count = heights.shape
    vertices = np.empty((row_count, column_count, 3))
    vertices[..., 0], vertices[..., 1] = elevation.x, elevation.y[:, None]
    vertices[..., 2] = heights

    first = np.arange(column_count - 1, dtype=np.int32)
    a = (first + column_count * np.arange(row_count - 1, dtype=np.int32)[:, None]).reshape(-1)
    faces = np.empty((len(a), 2, 3), np.int32)
    # The square's corners a, b, c, d go round it; the triangles are a, b, c and a, c, d.
    faces[..., 0] = a[:, None]
    faces[:, 0, 1], faces[:, 1, 2] = a + 1, a + column_count
    faces[:, 0, 2] = faces[:, 1, 1] = a + column_count + 1
    is_upward = (elevation.x[1] > elevation.x[0]) == (elevation.y[1] > elevation.y[0])
    if not is_upward:
        faces[..., 1:] = faces[..., :0:-1].copy()
    rows = faces.reshape(-1, 3)
    is_known = np.isfinite(heights).reshape(-1)
    if not is_known.all():
        rows = rows[is_known[rows].all(axis=1)]
    return vertices.reshape(-1, 3), rows


def hole_edges(heights: NDArray[np.float64]) -> NDArray[np.int64]:
    """The edges of triangles next to a missing one; not those at the border of the raster.

    Parameters
    ----------
    heights : ndarray of shape (H, W), float64
        NaN where there is no data.

    Returns
    -------
    ndarray of shape (E, 2), int64
        The cells at both ends, by number.
    """
    known = np.isfinite(heights)
    if known.all():
        return np.empty((0, 2), np.int64)
    a, b, c, d = known[:-1, :-1], known[:-1, 1:], known[1:, 1:], known[1:, :-1]
    upper, lower = a & b & c, a & c & d
    edges = []
    # Of each square: its diagonal; its lower side, with the square below; its right side.
    for is_edge, start, stop in (
        (upper != lower, (0, 0), (1, 1)),
        (lower[:-1] != upper[1:], (1, 0), (1, 1)),
        (upper[:, :-1] != lower[:, 1:], (0, 1), (1, 1)),
    ):
        rows, columns = np.nonzero(is_edge)
        ends = [(rows + row) * heights.shape[1] + columns + column for row, column in (start, stop)]
        edges.append(np.stack(ends, axis=1))
    return np.concatenate(edges)


def walls(
    elevation: Elevation, edges: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertical rectangles, of two triangles each, from edges down to below all ground.

    Parameters
    ----------
    elevation : Elevation
    edges : ndarray of shape (E, 2), int64
        From `hole_edges`.

    Returns
    -------
    vertices : ndarray of shape (V, 3), float64
    faces : ndarray of shape (2 * E, 3), int64
        Walls that meet share vertices.
    """
    cells, corners = np.unique(edges, return_inverse=True)
    row, column = np.divmod(cells, len(elevation.x))
    tops = np.stack([elevation.x[column], elevation.y[row], elevation.heights[row, column]], axis=1)
    low, high = np.nanmin(elevation.heights), np.nanmax(elevation.heights)
    bottoms = tops.copy()
    bottoms[:, 2] = low - max(high - low, np.ptp(elevation.x), np.ptp(elevation.y)) * _DEPTH
    p, q = corners.reshape(-1, 2).T
    below = len(cells)
    faces = np.stack([p, q, q + below, p, q + below, p + below], axis=1)
    return np.concatenate([tops, bottoms]), faces.reshape(-1, 3)
