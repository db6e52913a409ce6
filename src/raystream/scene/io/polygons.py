"""Polygons: triangulation into fans, and sharing of equal corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def fan_corners(
    counts: NDArray[np.int64], starts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut polygons into triangles that share the polygon's first corner.

    Parameters
    ----------
    counts : ndarray of shape (P,), int64
        Corners of each polygon; those with fewer than 3 give no triangle.
    starts : ndarray of shape (P,), int64
        First position of each polygon's corners in the caller's list of corners.

    Returns
    -------
    corners : ndarray of shape (F, 3), int64
        Positions in the caller's list of corners.
    polygon_ids : ndarray of shape (F,), int64
        The polygon of each triangle, non-decreasing.
    """
    fans = np.maximum(counts - 2, 0)
    polygon_ids = np.repeat(np.arange(len(counts)), fans)
    first_triangle = np.cumsum(fans) - fans
    step = np.arange(len(polygon_ids)) - first_triangle[polygon_ids]
    first = starts[polygon_ids]
    return np.stack([first, first + step + 1, first + step + 2], axis=1), polygon_ids


def distinct_corners(
    indices: NDArray[np.int64], first: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the distinct combinations of indices, such as vertex, texture coordinate, normal.

    Parameters
    ----------
    indices : ndarray of shape (C, K), int64
        One row per corner of a triangle; K >= 1.
    first : ndarray of shape (C,), int64, optional
        Instead of the first index.

    Returns
    -------
    rows : ndarray of shape (V,), int64
        One corner per combination, sorted by the first index, then by the others.
    places : ndarray of shape (C,), int64
        Combination of each corner.
    """
    places = indices[:, 0] if first is None else first
    rows = np.arange(len(indices))
    if len(indices) == 0:
        return rows, rows
    keys = places - places.min()
    for column in range(1, indices.shape[1]):
        other = indices[:, column]
        other = other - other.min()
        keys = keys * (int(other.max()) + 1) + other
        rows, keys = _distinct(keys)
    if indices.shape[1] == 1:
        rows, keys = _distinct(keys)
    return rows, keys.reshape(-1)


def _distinct(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First row of each key, in increasing order, and the key of each row; keys start at 0.

    Dense keys, such as a group's own vertices, are counted: that is faster than to sort them.
    """
    span = int(keys.max()) + 1
    if span > 4 * len(keys):
        _, rows, places = np.unique(keys, return_index=True, return_inverse=True)
        return rows, places
    firsts = np.full(span, -1, np.int64)
    firsts[keys[::-1]] = np.arange(len(keys) - 1, -1, -1)  # of equal keys the last one stays
    is_used = firsts >= 0
    numbers = np.cumsum(is_used) - 1
    return firsts[is_used], numbers[keys]
