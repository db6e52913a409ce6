"""Triangles over elevation rasters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.physics.elevation import Elevation


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
