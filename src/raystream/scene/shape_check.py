"""Checks of shapes by sample lines: bounds that are too small, and functions that disagree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.shapes import SLACK, Shapes

#: Boxes are this much larger on each side for the check, in units of their longest side.
_GROWTH = 1.0

#: Distances may be wrong by this part of a shape's longest side.
_TOLERANCE = 1e-3

#: Steps to a closest point.
_STEPS = 4


def check_shapes(shapes: Shapes, lines: int, seed: int) -> None:
    """Trace lines at each shape, without its bounds; see `Shape.check`."""
    rng, rows = np.random.default_rng(seed), np.arange(len(shapes))
    low, high = shapes.bounds.swapaxes(0, 1)
    sizes = np.maximum((high - low).max(axis=1), 1e-9 * np.abs(shapes.bounds).max(axis=(1, 2)))
    grow = _GROWTH * sizes[:, None]
    wide = replace(shapes, bounds=np.stack([low - grow, high + grow], axis=1))
    middle, reach = 0.5 * (low + high), 0.5 * (high - low) + 0.5 * grow
    for k in range(lines if len(shapes) else 0):
        aims = middle + rng.uniform(-1.0, 1.0, middle.shape) * reach
        axes = np.eye(3)[[k // 2 % 3] * len(rows)]
        directions = rng.normal(size=middle.shape) if k % 2 else axes
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        origins = aims - 2.0 * np.linalg.norm(reach, axis=1, keepdims=True) * directions
        t = shapes.functions.crossings_at(wide, rows, np.concatenate([origins, directions], axis=1))
        points = origins[:, None] + t[..., None] * directions[:, None]
        _check_bounds(shapes, points, sizes)
        first, is_hit = points[:, 0], np.isfinite(t[:, 0])
        _check_functions(shapes, rows[is_hit], first[is_hit], sizes[is_hit])
        if shapes.functions.has_distance:
            _check_distances(shapes, rows[is_hit], origins[is_hit], t[is_hit, 0], sizes[is_hit])


def _check_bounds(shapes: Shapes, points: NDArray[np.float64], sizes: NDArray[np.float64]) -> None:
    """Raise ValueError for a crossing, of shape (N, hits, 3), outside of its shape's box."""
    low, high = shapes.bounds.swapaxes(0, 1)
    slack = SLACK * sizes + 2.0**-40 * np.abs(shapes.bounds).max(axis=(1, 2))
    beside = np.maximum(low[:, None] - points, points - high[:, None]).max(axis=2)
    beside = np.where(np.isnan(beside), -np.inf, beside) - slack[:, None]
    row, k = np.unravel_index(int(beside.argmax()), beside.shape)
    if beside[row, k] > 0.0:
        raise ValueError(
            f"{shapes.functions.place('bounds')}: record {row}: the crossing at "
            f"{_shown(points[row, k])} is outside its bounds, {_shown(low[row])} to "
            f"{_shown(high[row])}"
        )


def _check_functions(
    shapes: Shapes, rows: NDArray[np.int64], points: NDArray[np.float64], sizes: NDArray[Any]
) -> None:
    """Raise ValueError where there is no normal at crossings, or a distance other than 0."""
    functions = shapes.functions
    normals = functions.normals_at(shapes, rows, points)
    bad = np.flatnonzero(~np.isfinite(normals).all(axis=1))
    if len(bad):
        row = bad[0]
        raise ValueError(
            f"{functions.place('normal')}: record {rows[row]}: there is no normal at the crossing "
            f"{_shown(points[row])}"
        )
    if not functions.has_distance:
        return
    distances = functions.distances_at(shapes, rows, points)
    bad = np.flatnonzero(~(np.abs(distances) <= _TOLERANCE * sizes))
    if len(bad):
        row = bad[0]
        raise ValueError(
            f"{functions.place('distance')}: record {rows[row]}: the distance of the crossing "
            f"{_shown(points[row])} is {distances[row]:.6g}"
        )


def _check_distances(
    shapes: Shapes,
    rows: NDArray[np.int64],
    points: NDArray[np.float64],
    most: NDArray[np.float64],
    sizes: NDArray[np.float64],
) -> None:
    """Raise ValueError where a distance is more than that of a crossing, or misses the surface."""
    functions = shapes.functions
    distances = functions.distances_at(shapes, rows, points)
    bad = np.flatnonzero(~(np.abs(distances) <= most + _TOLERANCE * sizes))
    if len(bad):
        row = bad[0]
        raise ValueError(
            f"{functions.place('distance')}: record {rows[row]}: the distance of "
            f"{_shown(points[row])} is {distances[row]:.6g}, but a crossing is {most[row]:.6g} away"
        )
    # As closest points are found, see `geometry.shapes.nearest.shape_foot`.
    feet = points
    for _ in range(_STEPS):
        step = distances[:, None] * functions.normals_at(shapes, rows, feet)
        feet = np.where(np.isfinite(step), feet - step, feet)
        distances = functions.distances_at(shapes, rows, feet)
    bad = np.flatnonzero(~(np.abs(distances) <= _TOLERANCE * sizes))
    if len(bad):
        row = bad[0]
        raise ValueError(
            f"{functions.place('distance')}: record {rows[row]}: its steps along the normal lead "
            f"from {_shown(points[row])} to {_shown(feet[row])}, where it is {distances[row]:.6g}; "
            "the distance may be a bound, or the normal right on the surface alone"
        )


def _shown(point: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{one:.6g}' for one in point)})"
