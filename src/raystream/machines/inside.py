"""Whether points are inside a surface: by the parity of crossings, or by winding numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.scene_checks import check_plain
from raystream.jit.threads import Progress
from raystream.kernels.solids import solids_of
from raystream.machines.winding import inside_by_winding

if TYPE_CHECKING:
    from raystream.machines.point_queries import PointQueries

#: Directions of the three rays: in no plane that people's models are likely to have.
_DIRECTIONS = (
    (0.5377, 0.8339, -0.1259),
    (-0.7643, 0.1987, 0.6135),
    (0.2281, -0.6911, -0.6857),
)

#: Steps of an equal part of a query.
_STEPS = 1 << 20

#: Meshes that an error names.
_MOST_NAMED = 3


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
        check_plain("inside tests", tracer.structure.triangles)
        self._tracer = tracer
        self._triangles = tracer.structure.triangles
        self._uses_rays = method == "rays"
        if self._uses_rays and not solids_of(self._triangles).is_closed_together:
            raise ValueError(
                f"method='rays' cannot tell inside from outside: {self._open_meshes()} open, or "
                "faces are oriented inconsistently; use method='winding'"
            )

    def _open_meshes(self) -> str:
        """Name the meshes that are not closed, some of them if they are many."""
        solids = solids_of(self._triangles)
        open_ids = np.flatnonzero(~solids.is_closed & ~solids.is_empty)
        names = [self._tracer.scene.meshes[i].name for i in open_ids[:_MOST_NAMED]]
        shown = [
            f"{i} ({name!r:.40})" if name else str(i)
            for i, name in zip(open_ids, names, strict=False)
        ]
        if len(open_ids) > len(shown):
            shown.append(f"{len(open_ids) - len(shown):,} more")
        many = "meshes" if len(open_ids) > 1 else "mesh"
        listed = " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
        return f"{many} {listed} {'are' if len(open_ids) > 1 else 'is'}"

    def inside(self, points: NDArray[Any], progress: Progress | None) -> NDArray[np.bool_]:
        """Test points of shape S + (3,); the result has shape (N,)."""
        points = points.reshape(-1, 3)
        if not self._uses_rays:
            return inside_by_winding(self._triangles, points, progress)
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
            rest = share_of(progress, 3, 1, 4)
            inside[doubtful] = inside_by_winding(self._triangles, points[doubtful], rest)
        elif progress:
            progress(count, count)
        return inside


def share_of(progress: Progress | None, first: int, parts: int, total: int) -> Progress | None:
    """Progress callback of some of `total` equal parts of a query, whatever their own steps."""
    if progress is None:
        return None
    whole = progress

    def report(done: int, count: int) -> object:
        share = parts * _STEPS * done // max(count, 1)
        return whole(first * _STEPS + share, total * _STEPS)

    return report
