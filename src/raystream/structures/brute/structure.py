"""BruteStructure: the triangles without acceleration."""

from __future__ import annotations

import time

import numpy as np

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures.base import BuildReport, Structure
from raystream.structures.brute.options import Brute
from raystream.structures.brute.traversal import BruteAddresses, traverse


class BruteStructure(Structure):
    """Brute force, built; see `Brute`.

    Parameters
    ----------
    triangles : Triangles
    options : Brute
    progress : callable, optional
        Called once: there is nothing to build.
    """

    traverse = staticmethod(traverse)

    def __init__(
        self, triangles: Triangles, options: Brute, *, progress: Progress | None = None
    ) -> None:
        started = time.perf_counter()
        self.triangles, self.options = triangles, options
        references = np.ascontiguousarray(triangles.prim_ids)
        corners = np.ascontiguousarray(triangles.corners)
        self.arrays = {"references": references, "corners": corners}
        references_at, corners_at = (np.uint64(one.ctypes.data) for one in self.arrays.values())
        self.view = BruteAddresses(references_at, corners_at, np.uint64(len(references)))
        self.report = BuildReport(
            seconds=time.perf_counter() - started,
            byte_count=sum(array.nbytes for array in self.arrays.values()),
        )
        if progress:
            progress(len(triangles.prim_ids), len(triangles.prim_ids))

    def quality(self) -> dict[str, float]:
        """The number of triangles that each ray is tested against."""
        return {"tests per ray": float(len(self.triangles.prim_ids))}

    @property
    def tests_per_ray(self) -> int:
        """All triangles."""
        return len(self.triangles.prim_ids)
