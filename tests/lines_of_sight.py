"""Lines of sight over triangulated rasters, in NumPy and float64: profiles, without rays."""

from __future__ import annotations

import numpy as np


def clearances(heights, spacing, eye, target_height=0.0):
    """Least height of the line from the eye to each cell above the ground on the way.

    Over a raster with centres at (column * dx, row * dy) the ground is linear between the lines of
    columns, rows and diagonals, so it is highest against a straight line on one of them.

    Parameters
    ----------
    heights : ndarray of shape (H, W)
        NaN where there is no data: in rectangles that leave no edge without a triangle.
    spacing : tuple of two float
    eye : array_like of shape (3,)
    target_height : float

    Returns
    -------
    ndarray of shape (H, W)
        Negative where the ground is in the way. The target's own cell does not count.
    """
    row_count, column_count = heights.shape
    dx, dy = spacing
    eye_u, eye_v, eye_z = eye[0] / dx, eye[1] / dy, eye[2]
    v, u = np.mgrid[:row_count, :column_count].astype(float)
    z = heights + target_height
    least = np.full(heights.shape, np.inf)
    lines = (
        [("u", k) for k in range(column_count)]
        + [("v", k) for k in range(row_count)]
        + [("diagonal", k) for k in range(1 - row_count, column_count)]
    )
    for kind, k in lines:
        with np.errstate(divide="ignore", invalid="ignore"):
            if kind == "u":
                part = (k - eye_u) / (u - eye_u)
            elif kind == "v":
                part = (k - eye_v) / (v - eye_v)
            else:
                part = (k - (eye_u - eye_v)) / ((u - v) - (eye_u - eye_v))
            # The last millionth is the target's own cell.
            is_between = (part > 0) & (part < 1 - 1e-6)
        if not is_between.any():
            continue
        along = part[is_between]
        at_u = eye_u + along * (u[is_between] - eye_u)
        at_v = eye_v + along * (v[is_between] - eye_v)
        if kind == "u":
            ground = _between(heights[:, k], at_v)
        elif kind == "v":
            ground = _between(heights[k], at_u)
        else:
            ground = _between(np.diagonal(heights, k), at_u - max(k, 0))
        gap = eye_z + along * (z[is_between] - eye_z) - ground
        least[is_between] = np.fmin(least[is_between], gap)
    return least


def _between(line, position):
    """Linear interpolation in a row of heights; NaN outside."""
    return np.interp(position, np.arange(len(line)), line, left=np.nan, right=np.nan)
