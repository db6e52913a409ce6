"""Winding numbers of points: exact sums, or a tree's, which says how far off it may be."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.point_order import order_bytes
from raystream.kernels.ray import MOST_COORDINATE
from raystream.kernels.winding import LANES, winding_numbers
from raystream.kernels.winding_tree import tree_winding_numbers, winding_tree_of
from raystream.machines.batch import run_calls, run_in_turn

#: Solid angles per call of the exact kernel: some 20 milliseconds.
_ANGLES_PER_CALL = 1 << 23

#: Points of a call of the tree's kernel, which sorts them.
_POINTS_PER_CALL = 1 << 12

#: Fewer triangles are summed exactly, and those of fewer points: a tree would take longer.
_LEAST_TRIANGLES, _LEAST_POINTS = 512, 256

#: Groups are expanded from where their radius is this much of the distance. The next is tried for
#: points that the one before left undecided, and then the exact sum.
_OPENINGS = (0.5, 0.2, 0.05)

#: The bound is rarely above the third power of the opening. The first to try for an accuracy has
#: this much of that; the least is one that is worthwhile.
_CUBE, _LEAST_OPENING = 0.7, 0.008


def winding_of(
    triangles: Triangles,
    points: NDArray[np.generic],
    progress: Progress | None = None,
    accuracy: float = 0.0,
) -> NDArray[np.float64]:
    """Winding numbers of points of shape (N, 3), world space; NaN for invalid ones."""
    is_valid = _are_valid(points)
    numbers = np.full(len(points), np.nan)
    most = min((accuracy * _CUBE) ** (1.0 / 3.0), _OPENINGS[0])
    openings = (most, 0.5 * most) if most >= _LEAST_OPENING else ()
    numbers[is_valid] = _numbers(triangles, points[is_valid], openings, accuracy, progress)
    return numbers


def inside_by_winding(
    triangles: Triangles, points: NDArray[np.generic], progress: Progress | None = None
) -> NDArray[np.bool_]:
    """Whether winding numbers of points of shape (N, 3) are above 1/2 or below -1/2.

    Decided by the exact sum wherever the tree's bounds leave a doubt.
    """
    is_valid = _are_valid(points)
    inside = np.zeros(len(points), bool)
    numbers = _numbers(triangles, points[is_valid], _OPENINGS, None, progress)
    inside[is_valid] = np.abs(numbers) > 0.5
    return inside


def _are_valid(points: NDArray[np.generic]) -> NDArray[np.bool_]:
    with np.errstate(invalid="ignore", over="ignore"):
        valid: NDArray[np.bool_] = (np.abs(points) <= MOST_COORDINATE).all(axis=-1)
    return valid


def _numbers(
    triangles: Triangles,
    points: NDArray[np.generic],
    openings: tuple[float, ...],
    accuracy: float | None,
    progress: Progress | None,
) -> NDArray[np.float64]:
    """Winding numbers within `accuracy`, or if it is None, on the right side of 1/2 and -1/2."""
    local, count = triangles.to_local(points, np.float64), len(points)
    numbers = np.zeros(count)
    if len(triangles.prim_ids) < _LEAST_TRIANGLES or count < _LEAST_POINTS:
        openings = ()

    def by_tree(opening: float, left: NDArray[np.int64], progress: Progress | None) -> Any:
        found, errors = _by_tree(triangles, local[left], opening, progress)
        numbers[left] = found
        room = np.abs(np.abs(found) - 0.5) if accuracy is None else accuracy
        return errors < room

    def exactly(left: NDArray[np.int64], progress: Progress | None) -> Any:
        numbers[left] = _exact(triangles, local[left], progress)
        return np.ones(len(left), bool)

    run_in_turn([*(partial(by_tree, one) for one in openings), exactly], count, progress)
    return numbers


def _by_tree(
    triangles: Triangles,
    local: NDArray[np.float64],
    opening: float,
    progress: Progress | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Winding numbers, and bounds of their errors."""
    tree, count, most = winding_tree_of(triangles), len(local), _POINTS_PER_CALL
    numbers, errors = np.empty(count), np.empty(count)
    calls = tree_winding_numbers, (local, tree, opening, numbers, errors)
    memory_bytes = order_bytes(min(count, most))
    run_calls(calls, (0, count), most, most, progress, memory_bytes=memory_bytes)
    return numbers, errors


def _exact(
    triangles: Triangles, local: NDArray[np.float64], progress: Progress | None
) -> NDArray[np.float64]:
    """Winding numbers by the sum over all triangles."""
    found = np.empty(len(local))
    prim_ids = np.ascontiguousarray(triangles.prim_ids)
    calls = winding_numbers, (local, triangles.corners, prim_ids, found)
    most = max(_ANGLES_PER_CALL // max(len(prim_ids), 1) // LANES, 1) * LANES
    run_calls(calls, (0, len(local)), most, most, progress)
    return found
