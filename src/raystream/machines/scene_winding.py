"""Winding numbers in scenes of any kind: sums over parts, each in a frame of its own.

An affine transform keeps winding numbers of closed surfaces, up to the sign of its determinant; of
open ones, they are those in object space. Instances keep that,
too: the front of a mirrored one stays in front, as if its faces were turned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.solid_parts import SolidPart
from raystream.jit.threads import Progress, part_of
from raystream.kernels.solids import solids_of
from raystream.machines.batch import run_calls
from raystream.machines.winding import are_valid, inside_by_winding, winding_of
from raystream.structures import Structure
from raystream.structures.batch_kernels import CallSize

#: Decisions by numbers that may be wrong by less than this come first.
_ROUGHLY = 0.125


def scene_winding(
    structure: Structure,
    points: NDArray[np.generic],
    progress: Progress | None = None,
    accuracy: float = 0.0,
) -> NDArray[np.float64]:
    """Winding numbers of points of shape (N, 3), world space; NaN for invalid ones."""
    if not structure.triangles.kinds:
        return winding_of(structure.triangles, points, progress, accuracy)
    parts = structure.triangles.solid_parts()
    is_valid = are_valid(points)
    numbers, valid = np.where(is_valid, 0.0, np.nan), np.flatnonzero(is_valid)
    order = np.argsort(points[valid, 0])
    by_x = valid[order]
    own, count = accuracy / max(len(parts), 1), max(len(points), 1)
    for k, part in enumerate(parts):
        report = part_of(progress, k * count, count, len(parts) * count)
        rows = _rows_near(part, points, by_x)
        if len(rows):
            numbers[rows] += winding_of(part.triangles, part.moved(points[rows]), report, own)
    # Only valid points: a NaN is no further from a tree's absent boxes than from the others.
    places, around = np.ascontiguousarray(points[valid], np.float64), np.zeros(len(valid))
    calls = structure.on_host.around_calls(places, around)
    if calls is not None:
        most = structure.rays_per_call
        run_calls(calls, (0, len(valid)), CallSize(structure.least_rays, most))
        numbers[valid] += around
    return numbers


def inside_scene(
    structure: Structure, points: NDArray[np.generic], progress: Progress | None = None
) -> NDArray[np.bool_]:
    """Whether winding numbers of points of shape (N, 3) are above 1/2 or below -1/2."""
    if not structure.triangles.kinds:
        return inside_by_winding(structure.triangles, points, progress)
    numbers = np.abs(scene_winding(structure, points, progress, _ROUGHLY))
    doubtful = np.flatnonzero(np.abs(numbers - 0.5) <= _ROUGHLY)
    numbers[doubtful] = np.abs(scene_winding(structure, points[doubtful]))
    inside: NDArray[np.bool_] = numbers > 0.5
    return inside


def _rows_near(
    part: SolidPart, points: NDArray[np.generic], by_x: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The rows, of those ordered by x, where a part's winding number may differ from 0."""
    if part.box is None or not solids_of(part.triangles).is_closed_together:
        return np.sort(by_x)
    low, high = part.box
    first, end = np.searchsorted(points[by_x, 0], (low[0], high[0]))
    rows = by_x[first : end + 1]
    near: NDArray[np.bool_] = ((points[rows] >= low) & (points[rows] <= high)).all(axis=1)
    # As they were given: sums of groups of triangles depend on which points are neighbours.
    return np.sort(rows[near])
