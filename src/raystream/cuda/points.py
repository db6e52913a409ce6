"""Closest points of points in host memory, found on a GPU in parts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.point_kernels import nearest_kernel
from raystream.cuda.structures import Resident
from raystream.jit.cuda import DeviceArray, Gpu
from raystream.jit.threads import Progress
from raystream.kernels.nearest import ROW
from raystream.kernels.point_queries import NearestAddresses, NearestArrays, PointSource, step_of
from raystream.structures import Structure

#: Most bytes of rows and answers that are on the device together.
_MOST_BYTES = 1 << 28


class _Answers(NamedTuple):
    """Arrays on the device as in `NearestArrays`."""

    distance: DeviceArray
    positions: DeviceArray
    u: DeviceArray
    v: DeviceArray
    prim_id: DeviceArray
    status: DeviceArray

    @classmethod
    def empty(cls, gpu: Gpu, count: int, capacity: int) -> _Answers:
        """Allocate uninitialised arrays."""
        rows = count * capacity
        return cls(
            gpu.empty("distances", rows, np.float64),
            gpu.empty("positions", (rows, 3), np.float64),
            gpu.empty("u", rows, np.float32),
            gpu.empty("v", rows, np.float32),
            gpu.empty("prim_ids", rows, np.int32),
            gpu.empty("status", count, np.uint8),
        )


class DevicePoints:
    """Finds the triangles nearest to points in host memory, part by part.

    Parameters
    ----------
    gpu : Gpu
    structure : Structure
    resident : Resident
        Its arrays on the device.
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
        self._resident = resident

    def find(
        self,
        points: NDArray[np.float64],
        limits: NDArray[np.float64],
        capacity: int,
        out: NearestArrays,
        progress: Progress | None = None,
    ) -> None:
        """Find the nearest triangles; see `machines.backend.Backend.find_nearest`."""
        count = len(points)
        each = capacity * (ROW.itemsize + 44) + 40
        at_once = max(min(self._at_once, _MOST_BYTES // each), 1)
        for begin in range(0, count, at_once):
            end = min(begin + at_once, count)
            own = limits if len(limits) == 1 else limits[begin:end]
            self._find_part(points[begin:end], own, capacity, _part(out, begin, end, capacity))
            if progress:
                progress(end, count)
        if progress and not count:
            progress(0, 0)

    def _find_part(
        self,
        points: NDArray[np.float64],
        limits: NDArray[np.float64],
        capacity: int,
        out: NearestArrays,
    ) -> None:
        gpu, structure, count = self._gpu, self._structure, len(points)
        given = gpu.upload("points", points)
        most = gpu.upload("limits", np.ascontiguousarray(limits))
        rows = gpu.empty("rows", count * capacity * ROW.itemsize, np.uint8)
        answers = _Answers.empty(gpu, count, capacity)
        source = PointSource(given.address, most.address, step_of(limits))
        to = NearestAddresses(*(one.address for one in answers))
        shared = source, structure.frame, self._resident.tree
        arguments = *shared, np.uint64(capacity), rows.address, to
        nearest_kernel(structure.name).launch(gpu, count, arguments)
        for name, one in answers._asdict().items():
            getattr(out, name)[...] = one.host()


def _part(out: NearestArrays, begin: int, end: int, capacity: int) -> NearestArrays:
    """Views of the rows of some points."""
    rows = slice(begin * capacity, end * capacity)
    vectors, weights = (out.distance[rows], out.positions[rows]), (out.u[rows], out.v[rows])
    return NearestArrays(*vectors, *weights, out.prim_id[rows], out.status[begin:end])
