"""RayLauncher: launches query kernels over rays on the device, sorted if wanted."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from raystream.core.hit_kinds import distance_type
from raystream.cuda.hit_ids import HitIds
from raystream.cuda.query_kernels import QueryKernels
from raystream.cuda.ray_order import sort_rays
from raystream.cuda.rays import DeviceRays, moved, usual_limits
from raystream.cuda.structures import Resident
from raystream.cuda.triangles import DeviceTriangles
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel, StreamScope
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.kernels.tally import ROW

__all__ = ["DeviceScene", "RayLauncher", "Steps", "resume"]

_Result = TypeVar("_Result")

#: Launches that depend on numbers from the device: yields arrays there, and is sent copies of them
#: on the host. The caller decides how to wait.
Steps = Generator[tuple[DeviceArray, ...], list[NDArray[Any]], _Result]


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
    triangles : Triangles, InstancedTriangles or Primitives
    is_sorted : bool
        Whether the kernels take rays in the order of their keys, see `ray_order`.
    program_triangles : DeviceTriangles
    ids : HitIds
    """

    gpu: Gpu
    kernels: QueryKernels
    resident: Resident
    frame: SceneFrame
    triangles: Any
    is_sorted: bool
    program_triangles: DeviceTriangles
    ids: HitIds


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

    def launch(self, kernel: RangeKernel, *arguments: Any, rows: slice | None = None) -> None:
        """Launch a kernel of `QueryKernels` for each ray, or for some rows of them.

        Does not wait. The addresses in `arguments` are those of the first of these rays.
        """
        scene, tallies = self.scene, None
        start, end, _ = (rows or slice(None)).indices(len(self))
        if self._tallies is not None:
            tallies = self._tallies.address + np.uint64(start) * ROW
        source, tree = self.rays.source_from(start), scene.resident.tree
        if self.rays.worlds is not None:
            tree = tree._replace(worlds=moved(self.rays.worlds, start, 4))
        shared: tuple[Any, ...] = source, scene.frame, tree, tallies
        if scene.is_sorted:
            shared = self._order(start, end - start).address, *shared
        self.scope.follow()
        self.scope.launch(kernel, end - start, (*shared, *arguments))

    def _order(self, start: int, count: int) -> DeviceArray:
        """Indices of some rays in the order of their keys, sorted once."""
        if (start, count) not in self._orders:
            scope, source = self.scope, self._float32_limits(self.rays.source_from(start))
            order = sort_rays(scope.gpu, source, count, self.scene.frame, scope.ready, scope.stream)
            self._orders[start, count] = order
        return self._orders[start, count]

    def _float32_limits(self, source: RaySource) -> RaySource:
        """A source for keys, which do not depend on the limits, but read float32 there."""
        if distance_type(self.scene.triangles) is np.float32:
            return source
        limits = usual_limits(self.scene.gpu)
        low, high, none = limits[0.0].address, limits[np.inf].address, np.uint64(0)
        return source._replace(t_min=low, t_min_step=none, t_max=high, t_max_step=none)
