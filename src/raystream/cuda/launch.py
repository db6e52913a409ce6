"""RayLauncher: launches query kernels over rays on the device, sorted and with tables as needed."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.cuda.query_kernels import RETRY, QueryKernels, SeenTables
from raystream.cuda.ray_order import sort_rays
from raystream.cuda.rays import DeviceRays
from raystream.cuda.scan import note_value
from raystream.cuda.structures import Resident
from raystream.cuda.triangles import DeviceTriangles
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel, StreamScope
from raystream.kernels.ray import SceneFrame
from raystream.kernels.search import LEAST_ROOM
from raystream.kernels.tally import ROW

__all__ = ["DeviceScene", "RayLauncher", "Steps", "resume"]

_Result = TypeVar("_Result")

#: Launches that depend on numbers from the device: yields arrays there, and is sent copies of them
#: on the host. The caller decides how to wait.
Steps = Generator[tuple[DeviceArray, ...], list[NDArray[Any]], _Result]

#: Most bytes of the tables of triangles seen.
TABLE_BYTES = 1 << 28

#: Growth of the tables after one was too small.
GROWTH = 8

_NO_TABLES = SeenTables(np.uint64(0), np.uint64(0))


def resume(steps: Steps[None], copies: list[NDArray[Any]] | None) -> tuple[DeviceArray, ...] | None:
    """Begin a query, or resume it with copies of what it read; None when all is launched."""
    try:
        return next(steps) if copies is None else steps.send(copies)
    except StopIteration:
        return None


class DeviceScene(NamedTuple):
    """A structure on a device, its kernels, and the triangles for programs.

    Attributes
    ----------
    gpu : Gpu
    kernels : QueryKernels
    resident : Resident
    frame : SceneFrame
    triangles : Triangles
    has_duplicates : bool
        Whether the structure lists triangles several times, so that rays need tables.
    is_sorted : bool
        Whether the kernels take rays in the order of their keys, see `ray_order`.
    program_triangles : DeviceTriangles
    """

    gpu: Gpu
    kernels: QueryKernels
    resident: Resident
    frame: SceneFrame
    triangles: Triangles
    has_duplicates: bool
    is_sorted: bool
    program_triangles: DeviceTriangles


class RayLauncher:
    """Launches kernels over the rays of one query.

    Parameters
    ----------
    scene : DeviceScene
    scope : StreamScope
        Holds the memory of the query.
    rays : DeviceRays
    first : int
        Index of the first ray in its batch.
    tallies : DeviceArray, optional
        Counters of each ray, see `kernels.tally`.
    report : callable, optional
        ``report(done, passes)`` is called between the passes of a query.
    """

    def __init__(
        self,
        scene: DeviceScene,
        scope: StreamScope,
        rays: DeviceRays,
        first: int = 0,
        tallies: DeviceArray | None = None,
        report: Callable[[int, int], None] = lambda *_: None,
    ) -> None:
        self.scene, self.scope, self.rays, self.first = scene, scope, rays, first
        self.report = report
        self._tallies = tallies
        self._orders: dict[tuple[int, int], DeviceArray] = {}

    def __len__(self) -> int:
        return len(self.rays)

    def launch(self, kernel: RangeKernel, *arguments: Any) -> None:
        """Launch a kernel of `QueryKernels` for each ray; does not wait."""
        self._launch(self.scope, kernel, 0, len(self), arguments)

    def launch_with_tables(
        self,
        kernel: RangeKernel,
        counts: DeviceArray,
        arguments_at: Callable[[int], tuple[Any, ...]],
        start: int = 0,
    ) -> Steps[None]:
        """Launch a kernel that needs tables of triangles seen, until all of them are large enough.

        Parameters
        ----------
        kernel : RangeKernel
        counts : DeviceArray of shape (N,), int64
            Output of the kernel: `RETRY` for rays whose table was too small.
        arguments_at : callable
            Maps the offset of a ray to the arguments that follow the tables.
        start : int
            The first of the N rays.
        """
        if not self.scene.has_duplicates:
            arguments = _NO_TABLES, *arguments_at(0)
            self._launch(self.scope, kernel, start, len(counts), arguments)
            return
        room = int(LEAST_ROOM)
        while True:
            most = min(max(TABLE_BYTES // (4 * room + 4), 1), len(counts))
            with self.scope.nested() as inner:
                memory = inner.empty("tables of triangles seen", (most, room + 1), np.int32)
                tables = SeenTables(memory.address, np.uint64(room))
                for offset in range(0, len(counts), max(most, 1)):
                    count = min(most, len(counts) - offset)
                    self._launch(
                        inner, kernel, start + offset, count, (tables, *arguments_at(offset))
                    )
                (has_overflowed,) = yield (note_value(inner, counts, RETRY),)
            if not has_overflowed[0]:
                return
            if self._tallies is not None:
                self.scope.gpu.clear(self._tallies, self.scope.stream)
            room *= GROWTH

    def _launch(
        self,
        inner: StreamScope,
        kernel: RangeKernel,
        start: int,
        count: int,
        arguments: tuple[Any, ...],
    ) -> None:
        scene, source, tallies = self.scene, self.rays.source_from(start), None
        if self._tallies is not None:
            tallies = self._tallies.address + np.uint64(start) * ROW
        shared: tuple[Any, ...] = source, scene.frame, scene.resident.tree, tallies
        if scene.is_sorted:
            shared = self._order(start, count).address, *shared
        self.scope.follow()
        inner.launch(kernel, count, (*shared, *arguments))

    def _order(self, start: int, count: int) -> DeviceArray:
        """Indices of some rays in the order of their keys, sorted once."""
        if (start, count) not in self._orders:
            scope, source = self.scope, self.rays.source_from(start)
            order = sort_rays(scope.gpu, source, count, self.scene.frame, scope.ready, scope.stream)
            self._orders[start, count] = order
        return self._orders[start, count]
