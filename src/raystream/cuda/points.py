"""Closest points of points in host memory, found on a GPU in parts."""

from __future__ import annotations

from functools import cache, cached_property, partial
from typing import Any

import numpy as np

from raystream.cuda.builders.device_resident import Resident
from raystream.cuda.bvh.kernels import Traced, layout_of, traced_as
from raystream.cuda.structures import place_points
from raystream.jit.cuda import Gpu, RangeKernel
from raystream.jit.threads import Progress
from raystream.kernels.answers import thread_of
from raystream.kernels.nearest import ROW
from raystream.kernels.point_queries import (
    NearestArrays,
    PointBatch,
    PointScene,
    nearest_answer,
    step_of,
)
from raystream.structures import Structure, form_of

#: Most bytes of rows and answers that are on the device together.
_MOST_BYTES = 1 << 28


@cache
def nearest_kernel(made: Traced) -> RangeKernel:
    """The kernel of a structure that is traced so; see `nearest_answer`."""
    if isinstance(made, str):
        search = form_of(made, "nearest search")
    else:
        held: Any = layout_of(made) or made
        search = held.point_search
    return RangeKernel(thread_of(*nearest_answer(search)))


class DevicePoints:
    """Finds the triangles nearest to points in host memory, part by part.

    Parameters
    ----------
    gpu : Gpu
    structure : Structure
    resident : Resident
        Its arrays on the device, for rays.
    points_at_once : int
        Most points on the device together; fewer if each has many rows.
    """

    def __init__(
        self,
        gpu: Gpu,
        structure: Structure,
        resident: Resident,
        points_at_once: int,
    ) -> None:
        self._gpu, self._structure, self._at_once = gpu, structure, points_at_once
        self._rays = resident

    @cached_property
    def _resident(self) -> Resident:
        return place_points(self._structure, self._gpu, self._rays)

    def find(self, batch: PointBatch, out: NearestArrays, progress: Progress | None = None) -> None:
        """Find the nearest triangles; see `machines.backend.Backend.find_nearest`."""
        points, limits, capacity = batch
        count = len(points)
        each = capacity * (ROW.itemsize + 44) + 40
        at_once = max(min(self._at_once, _MOST_BYTES // each), 1)
        for begin in range(0, count, at_once):
            end = min(begin + at_once, count)
            own = limits if len(limits) == 1 else limits[begin:end]
            found = self._find_part(PointBatch(points[begin:end], own, capacity))
            for one, whole in zip(found, out, strict=True):
                rows = len(whole) // count
                whole[begin * rows : end * rows] = one.host()
            if progress:
                progress(end, count)
        if progress and not count:
            progress(0, 0)

    def _find_part(self, batch: PointBatch) -> Any:
        """The answers of some points, as `NearestArrays` on the device."""
        gpu, structure, (points, limits, capacity) = self._gpu, self._structure, batch
        count = len(points)
        given = gpu.upload("points", points)
        most = gpu.upload("limits", np.ascontiguousarray(limits))
        rows = gpu.empty("rows", count * capacity * ROW.itemsize, np.uint8)
        answers: Any = NearestArrays.empty(count, capacity, partial(gpu.empty, "closest points"))
        source = given.address, most.address, step_of(limits)
        shared = structure.frame, self._resident.tree, np.uint64(capacity)
        scene = PointScene(*source, *shared, rows.address, None)
        to = NearestArrays(*(one.address for one in answers))
        nearest_kernel(traced_as(structure)).launch(gpu, count, (scene, to))
        return answers
