"""Whether points are inside a surface: by the parity of crossings, or by winding numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for
from raystream.kernels.solids import solids_of
from raystream.kernels.winding import LANES, winding_numbers

if TYPE_CHECKING:
    from raystream.machines.point_queries import PointQueries

__all__ = ["InsideTest", "share_of", "winding_of"]

#: Directions of the three rays: in no plane that people's models are likely to have.
_DIRECTIONS = (
    (0.5377, 0.8339, -0.1259),
    (-0.7643, 0.1987, 0.6135),
    (0.2281, -0.6911, -0.6857),
)

#: Solid angles per call of the kernel: some 20 milliseconds.
_ANGLES_PER_CALL = 1 << 23

#: Steps of an equal part of a query.
_STEPS = 1 << 20

#: Coordinates beyond this are invalid, as those of rays.
_FARTHEST = 2.0**200


class InsideTest:
    """The test of points by one of the methods of `PointQueries.contains`.

    Parameters
    ----------
    tracer : PointQueries
    method : {"rays", "winding"}

    Raises
    ------
    ValueError
        If the method is unknown, or the surface is not closed and the method needs that.
    """

    def __init__(self, tracer: PointQueries, method: str) -> None:
        if method not in ("rays", "winding"):
            raise ValueError(f"method: expected 'rays' or 'winding', got {method!r:.80}")
        self._tracer = tracer
        self._triangles = tracer.structure.triangles
        self._uses_rays = method == "rays"
        if self._uses_rays and not solids_of(self._triangles).is_closed_together:
            raise ValueError(
                "method: 'rays' needs a closed surface, and the scene's is open, or its faces are "
                "oriented inconsistently; give method='winding'"
            )

    def inside(self, points: NDArray[Any], progress: Progress | None) -> NDArray[np.bool_]:
        """Test points of shape S + (3,); the result has shape (N,)."""
        points = points.reshape(-1, 3)
        if not self._uses_rays:
            return self._by_winding(points, progress)
        count = len(points)
        crossed = np.zeros(count, np.uint8)
        for k, direction in enumerate(_DIRECTIONS):
            counts = self._tracer.count_hits(
                points,
                np.array(direction, np.float32),
                crossings="surfaces",
                progress=share_of(progress, k, 1, 4),
            )
            crossed += (counts & 1).astype(np.uint8)
        inside: NDArray[np.bool_] = crossed == len(_DIRECTIONS)
        doubtful = np.flatnonzero((crossed != 0) & ~inside)
        if len(doubtful):
            inside[doubtful] = self._by_winding(points[doubtful], share_of(progress, 3, 1, 4))
        elif progress:
            progress(count, count)
        return inside

    def _by_winding(self, points: NDArray[Any], progress: Progress | None) -> NDArray[np.bool_]:
        numbers = winding_of(self._triangles, points, progress)
        with np.errstate(invalid="ignore"):
            inside: NDArray[np.bool_] = np.abs(numbers) > 0.5
        return inside


def winding_of(
    triangles: Triangles, points: NDArray[Any], progress: Progress | None = None
) -> NDArray[np.float64]:
    """Winding numbers of points of shape (N, 3), world space; NaN for invalid ones."""
    with np.errstate(invalid="ignore", over="ignore"):
        is_valid = (np.abs(points) <= _FARTHEST).all(axis=-1)
        local = (np.asarray(points[is_valid], np.float64) - triangles.center) * triangles.scale
    found = np.zeros(len(local))
    corners, prim_ids = triangles.corners, np.ascontiguousarray(triangles.prim_ids)

    def body(begin: int, end: int) -> None:
        winding_numbers(begin, end, local, corners, prim_ids, found)

    if len(prim_ids):
        most = max(_ANGLES_PER_CALL // len(prim_ids) // LANES, 1) * LANES
        parallel_for(body, len(local), most, progress)
    elif progress:
        progress(len(local), len(local))
    numbers = np.full(len(points), np.nan)
    numbers[is_valid] = found
    return numbers


def share_of(progress: Progress | None, first: int, parts: int, total: int) -> Progress | None:
    """Progress callback of some of `total` equal parts of a query, whatever their own steps."""
    if progress is None:
        return None
    whole = progress

    def report(done: int, count: int) -> object:
        share = parts * _STEPS * done // max(count, 1)
        return whole(first * _STEPS + share, total * _STEPS)

    return report
