"""Polygons: cut into triangles, and sharing of equal corners."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.io.ear_clipping import clip_ears
from raystream.scene.io.partial import warn_crossed

#: A fan may have triangles that face backwards with less area than this times the square of the
#: polygon's size: corners in line that were rounded to float32.
_ROUNDED = 1e-7

#: Corners examined at a time: their coordinates fit into a cache.
_BLOCK = 1 << 15


class Cut(NamedTuple):
    """Polygons as triangles.

    Attributes
    ----------
    corners : ndarray of shape (F, 3), int64
        Positions in the caller's list of corners.
    polygon_ids : ndarray of shape (F,), int64
        The polygon of each triangle, non-decreasing.
    crossed_count : int
        Polygons that are fans although they are not convex, as their outlines cross themselves.
    """

    corners: NDArray[np.int64]
    polygon_ids: NDArray[np.int64]
    crossed_count: int


def polygon_triangles(
    path: Path,
    counts: NDArray[np.int64],
    starts: NDArray[np.int64],
    indices: NDArray[Any],
    vertices: NDArray[Any],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cut the polygons of a file into triangles, with a warning; see `cut_polygons`.

    Returns
    -------
    corners, polygon_ids
        See `Cut`.
    """
    cut = cut_polygons(counts, starts, indices, vertices)
    warn_crossed(path, cut.crossed_count)
    return cut.corners, cut.polygon_ids


def cut_polygons(
    counts: NDArray[np.int64],
    starts: NDArray[np.int64],
    indices: NDArray[Any],
    vertices: NDArray[Any],
) -> Cut:
    """Cut polygons into triangles: fans where they are right, as in convex ones, else ears.

    Parameters
    ----------
    counts, starts : ndarray of shape (P,), int64
        See `fan_corners`.
    indices : ndarray of shape (C,), integer
        The vertex of each corner in the caller's list, of any value: polygons with indices out of
        range become fans.
    vertices : ndarray of shape (V, 3), float
    """
    corners, polygon_ids = fan_corners(counts, starts)
    if int(counts.max(initial=0)) < 4 or len(vertices) == 0:
        return Cut(corners, polygon_ids, 0)
    folded = _folded(counts, starts, indices, vertices)
    if len(folded) == 0:
        return Cut(corners, polygon_ids, 0)
    places = _places(counts[folded], starts[folded])
    points = vertices[indices[places].astype(np.int64)].astype(np.float64)
    ears, is_cut = clip_ears(points, counts[folded])
    is_replaced = np.zeros(len(counts), bool)
    is_replaced[folded[is_cut]] = True
    corners[is_replaced[polygon_ids]] = places[ears]
    return Cut(corners, polygon_ids, len(folded) - int(np.count_nonzero(is_cut)))


def _places(counts: NDArray[np.int64], starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Positions of the corners of some polygons in the caller's list, one polygon after another."""
    firsts = np.cumsum(counts) - counts
    return np.arange(int(counts.sum())) + np.repeat(starts - firsts, counts)


def _folded(
    counts: NDArray[np.int64],
    starts: NDArray[np.int64],
    indices: NDArray[Any],
    vertices: NDArray[Any],
) -> NDArray[np.int64]:
    """Find polygons whose fans have triangles that face backwards, in increasing order."""
    found = [np.zeros(0, np.int64)]
    indices = np.ascontiguousarray(indices)  # a column would be copied for each block
    for count in np.flatnonzero(np.bincount(counts)).tolist():
        if count > 3:
            alike = np.flatnonzero(counts == count)
            step = max(1, _BLOCK // count)
            for first in range(0, len(alike), step):
                part = alike[first : first + step]
                vertex = indices.take(starts[part] + np.arange(count)[:, None])
                found.append(part[_is_folded(vertex, vertices)])
    return np.sort(np.concatenate(found))


def _is_folded(vertex: NDArray[Any], vertices: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether each fan has triangles that face backwards; False with indices out of range.

    Parameters
    ----------
    vertex : ndarray of shape (N, P), integer
        The corners of polygons of N corners.
    vertices : ndarray of shape (V, 3), float
    """
    inside = (vertex >= 0) & (vertex < len(vertices))
    if not inside.all():
        vertex = np.where(inside, vertex, 0)
    points = vertices.take(vertex, axis=0)
    axes = np.moveaxis(points, -1, 0).astype(np.float64, order="C")
    with np.errstate(all="ignore"):
        x, y, z = axes[:, 1:] - axes[:, :1]
        twice = np.stack(
            [
                y[:-1] * z[1:] - z[:-1] * y[1:],
                z[:-1] * x[1:] - x[:-1] * z[1:],
                x[:-1] * y[1:] - y[:-1] * x[1:],
            ]
        )
        normals = twice.sum(axis=1)
        along = (twice * normals[:, None]).sum(axis=0).min(axis=0)
        squares = (normals * normals).sum(axis=0)
        folded = (along < 0.0) | (squares == 0.0)
        if not folded.any():
            return folded
        size = np.abs((x, y, z)).max(axis=(0, 1))
        least = _ROUNDED * size * size
        largest = (twice * twice).sum(axis=0).max(axis=0)
        folded = (along < -least * np.sqrt(squares)) | (squares <= least * least)
        # With no area at all there is nothing to mend.
        folded &= (largest > least * least) & np.isfinite(squares)
    return folded & inside.all(axis=0)


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
