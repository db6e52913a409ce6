"""Whether points are inside a surface: by the parity of crossings, or by winding numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.scene_kinds import check_support
from raystream.core.solid_parts import SolidPart
from raystream.jit.threads import Progress, parts
from raystream.kernels.crossing_sides import net_exits
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.kernels.solids import open_edges, solids_of
from raystream.machines.batch import run_calls
from raystream.machines.scene_winding import inside_scene
from raystream.structures.batch_kernels import CallSize

#: Directions of the three rays: in no plane that people's models are likely to have.
_DIRECTIONS = (
    (0.5377, 0.8339, -0.1259),
    (-0.7643, 0.1987, 0.6135),
    (0.2281, -0.6911, -0.6857),
)

#: Meshes and edges that an error names.
_MOST_NAMED = 3

#: Points whose crossings are stored at once, and calls of the kernel that reads them.
_POINTS_AT_ONCE, _CALLS = 1 << 20, CallSize(1 << 13, 1 << 13)


class InsideTest:
    """The test of points by one of the methods of `PointQueries.contains`.

    Parameters
    ----------
    tracer : Tracer
    method : {"rays", "winding"}

    Raises
    ------
    ValueError
        If the method is unknown, or the surface is not closed and the method needs that.
    """

    def __init__(self, tracer: Any, method: str) -> None:
        if method not in ("rays", "winding"):
            raise ValueError(f"method: expected 'rays' or 'winding', got {method!r:.80}")
        check_support("inside tests", tracer.structure.triangles)
        self._tracer = tracer
        self._triangles = tracer.structure.triangles
        self._uses_rays = method == "rays"
        for part in self._triangles.solid_parts() if self._uses_rays else ():
            if part.open_kind or not solids_of(part.triangles).is_closed_together:
                raise ValueError(
                    f"method='rays' cannot tell inside from outside: {self._open_meshes(part)}; "
                    "use method='winding'"
                )

    def _open_meshes(self, part: SolidPart) -> str:
        """Name the meshes that are not closed and their open edges, some of them if many."""
        if part.open_kind:
            return f"{part.open_kind} is an open surface"
        found = open_edges(part.triangles)
        open_ids = found.mesh_ids + part.first_mesh
        names = [self._tracer.scene.meshes[i].name for i in open_ids[:_MOST_NAMED]]
        shown = [
            f"{i} ({name!r:.40})" if name else str(i)
            for i, name in zip(open_ids, names, strict=False)
        ]
        many = ("meshes", "are") if len(open_ids) > 1 else ("mesh", "is")
        edges = [
            " to ".join(f"({x:.6g}, {y:.6g}, {z:.6g})" for x, y, z in pair)
            for pair in found.ends[:_MOST_NAMED]
        ]
        count = len(found.ends)
        return (
            f"{many[0]} {_listed(shown, len(open_ids))} {many[1]} open, or faces are oriented "
            f"inconsistently, at {count:,} edge{'s' if count > 1 else ''}: {_listed(edges, count)}"
        )

    def inside(self, points: NDArray[Any], progress: Progress | None) -> NDArray[np.bool_]:
        """Test points of shape S + (3,); the result has shape (N,)."""
        points = points.reshape(-1, 3)
        if not self._uses_rays:
            return inside_scene(self._tracer.structure, points, progress)
        count = len(points)
        crossed, escapes = np.zeros(count, np.uint8), np.zeros(count, bool)
        # Two more parts: points in several solids, and doubtful ones.
        part, total = max(count, 1), (len(_DIRECTIONS) + 2) * max(count, 1)
        *of_rays, of_even, of_doubtful = (report for _, report in parts(total, part, progress))
        for k, report in enumerate(of_rays):
            counts = self._tracer.count_hits(
                points, _direction(k), crossings="surfaces", progress=report
            )
            crossed += (counts & 1).astype(np.uint8)
            escapes |= counts == 0
        inside: NDArray[np.bool_] = crossed == len(_DIRECTIONS)
        # An even number of crossings: outside, or in several solids at once.
        even = np.flatnonzero((crossed == 0) & ~escapes)
        for rows, report in parts(len(even), _POINTS_AT_ONCE, of_even):
            some = even[rows]
            if self._triangles.kinds:
                inside[some] = inside_scene(self._tracer.structure, points[some], report)
            else:
                inside[some] = self._net_exits(points[some], report) != 0
        doubtful = np.flatnonzero((crossed != 0) & (crossed != len(_DIRECTIONS)))
        inside[doubtful] = inside_scene(self._tracer.structure, points[doubtful], of_doubtful)
        return inside

    def _net_exits(self, points: NDArray[Any], progress: Progress | None) -> NDArray[np.int64]:
        """Winding numbers of points in a closed surface, by the crossings of one ray."""
        found = self._tracer.multi_hit(
            points, _direction(0), crossings="surfaces", progress=progress
        )
        rays = RayBatch(points, _direction(0), 0.0, np.inf)
        source, kept = RaySource.of(rays.origins, rays.directions, rays.limits)
        corners, frame = self._triangles.corners, SceneFrame.of(self._triangles)
        exits = np.empty(len(points), np.int64)
        calls = net_exits, (source, frame, corners, found.ray_splits, found.prim_id, exits)
        run_calls(calls, (0, len(points)), _CALLS)
        del kept
        return exits


def _direction(k: int) -> NDArray[np.float32]:
    return np.array(_DIRECTIONS[k], np.float32)


def _listed(shown: list[str], total: int) -> str:
    """Join phrases, the last by "and"; how many more there are, if not all are shown."""
    if total > len(shown):
        shown = [*shown, f"{total - len(shown):,} more"]
    return " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
