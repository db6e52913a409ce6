"""Brute force by passes: each tests one triangle, a constant of the kernel, on all rays.

Foley 2005, section 3, after Carr, Hall and Hart, "The Ray Engine", 2002: "It intersects an entire
stream of rays with a single triangle at a time, passed in using constant arguments".
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import device
from raystream.kernels.local_frame import LocalRays
from raystream.machines.records import INTERSECTING, RayState
from raystream.machines.steps.base import StepKernel, Steps
from raystream.streams import Counters, Kernel, Stream
from raystream_lab.as_published.triangle import PrintedHit, intersect_triangle

RAY = np.dtype([("origin", np.float32, 3), ("direction", np.float32, 3)])
HIT = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("prim_id", "i4")])


def triangle_pass(ray, hit, v0, v1, v2, prim_id):
    """Test one triangle on a ray: the kernel of all passes."""
    o, d = ray.origin, ray.direction
    h = PrintedHit(hit.t, hit.u, hit.v, hit.prim_id)
    origin, direction = (o[0], o[1], o[2]), (d[0], d[1], d[2])
    return intersect_triangle(origin, direction, v0, v1, v2, prim_id, h)


class BruteForce:
    """First hits by as many passes over all rays as there are triangles.

    Parameters
    ----------
    triangles : Triangles
    rays : LocalRays
        In their frame, from `kernels.snapshots.local_rays`.

    Attributes
    ----------
    hits : Stream of `HIT`
        A miss has t = `t_max` of its ray and prim_id = -1.
    """

    def __init__(self, triangles: Triangles, rays: LocalRays) -> None:
        self.triangles = triangles
        ray = np.empty(len(rays.t_min), RAY)
        ray["origin"], ray["direction"] = rays.origins, rays.directions
        self._start = np.zeros(len(ray), HIT)
        self._start["t"], self._start["prim_id"] = rays.t_max, -1
        self.hits = Stream(self._start.copy(), name="hit")
        self._kernel = Kernel(
            triangle_pass,
            inputs={"ray": Stream(ray, name="ray"), "hit": self.hits},
            outputs=self.hits,
            constants=_constants(np.zeros((3, 3), np.float32), -1),
            name="intersect",
        )

    def run(self, counters: Counters | None = None) -> int:
        """Trace the rays from the start; returns the number of passes."""
        self.hits.array[:] = self._start
        for prim_id in self.triangles.prim_ids.tolist():
            self._kernel.set_constants(**_constants(self.triangles.corners[prim_id], prim_id))
            self._kernel.execute(counters=counters)
        return len(self.triangles.prim_ids)


class _Triangle(NamedTuple):
    """The constants of a pass."""

    v0: tuple[np.float32, np.float32, np.float32]
    v1: tuple[np.float32, np.float32, np.float32]
    v2: tuple[np.float32, np.float32, np.float32]
    prim_id: np.int32


_test = device(triangle_pass)


def _intersect(ray, place, tree):
    return _test(ray, place, tree.v0, tree.v1, tree.v2, tree.prim_id), INTERSECTING


def brute_steps() -> Steps:
    """The kernel as that of a traversal, for `kernels.costs`; `BruteForce` runs it."""
    kernel = StepKernel("intersect", RayState.INTERSECTING, device(_intersect), ("place",))
    return Steps((kernel,), HIT, _Triangle(**_constants(np.zeros((3, 3), np.float32), -1)))


def _constants(corners: NDArray[np.float32], prim_id: int) -> dict[str, Any]:
    v0, v1, v2 = (tuple(np.float32(x) for x in corner) for corner in corners)
    return {"v0": v0, "v1": v1, "v2": v2, "prim_id": np.int32(prim_id)}
