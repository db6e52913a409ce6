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
from raystream.machines.batch import DecidingKernel, run_in_turn
from raystream.structures.batch_kernels import Calls, CallSize

#: Solid angles per call of the exact kernel: some 20 milliseconds.
_ANGLES_PER_CALL = 1 << 23

#: Calls of the tree's kernel, which sorts their points.
_POINTS_PER_CALL = 1 << 12
_TREE_CALLS = CallSize(
    _POINTS_PER_CALL,
    _POINTS_PER_CALL,
    memory_bytes=order_bytes(_POINTS_PER_CALL),
    joins_chunks=False,
)

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
    is_valid = are_valid(points)
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
    is_valid = are_valid(points)
    inside = np.zeros(len(points), bool)
    numbers = _numbers(triangles, points[is_valid], _OPENINGS, None, progress)
    inside[is_valid] = np.abs(numbers) > 0.5
    return inside


def are_valid(points: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Which points of shape (N, 3) have finite coordinates that are not too large."""
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
    local = triangles.to_local(points, np.float64)
    numbers = np.zeros(len(local))
    if len(triangles.prim_ids) < _LEAST_TRIANGLES:
        openings = ()

    def by_tree(opening: float, left: NDArray[np.int64]) -> Any:
        calls, found, errors = _tree_sums(triangles, local[left], opening)

        def decide() -> NDArray[np.bool_]:
            numbers[left] = found
            room = np.abs(np.abs(found) - 0.5) if accuracy is None else accuracy
            return errors < room

        return calls, decide

    def exactly(left: NDArray[np.int64]) -> Any:
        calls, found = _exact_sums(triangles, local[left])

        def decide() -> NDArray[np.bool_]:
            numbers[left] = found
            return np.ones(len(left), np.bool_)

        return calls, decide

    most = max(_ANGLES_PER_CALL // max(len(triangles.prim_ids), 1) // LANES, 1) * LANES
    exact = DecidingKernel(exactly, CallSize(most, most, joins_chunks=False))
    trees = [DecidingKernel(partial(by_tree, one), _TREE_CALLS, _LEAST_POINTS) for one in openings]
    run_in_turn([*trees, exact], len(local), progress)
    return numbers


def _tree_sums(
    triangles: Triangles, local: NDArray[np.float64], opening: float
) -> tuple[Calls, NDArray[np.float64], NDArray[np.float64]]:
    """The calls that compute winding numbers by the tree; these, and bounds of their errors."""
    numbers, errors = np.empty((2, len(local)))
    tree = winding_tree_of(triangles)
    return (tree_winding_numbers, (local, tree, opening, numbers, errors)), numbers, errors


def _exact_sums(
    triangles: Triangles, local: NDArray[np.float64]
) -> tuple[Calls, NDArray[np.float64]]:
    """The calls that sum over all triangles, and the winding numbers."""
    numbers, prim_ids = np.empty(len(local)), np.ascontiguousarray(triangles.prim_ids)
    return (winding_numbers, (local, triangles.corners, prim_ids, numbers)), numbers
