"""RayLauncher: launches query kernels over rays on the device."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.builders.device_resident import Resident
from raystream.cuda.hit_ids import HitIds
from raystream.cuda.masks import DeviceMasks
from raystream.cuda.rays import DeviceRays, moved
from raystream.cuda.triangles import DeviceTriangles
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel, StreamScope
from raystream.kernels.queries import RayAnswers, RayScene
from raystream.kernels.ray import SceneFrame
from raystream.kernels.tally import ROW

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
    kernels : RayAnswers
        Of its queries.
    resident : Resident
    frame : SceneFrame
    triangles : Triangles, InstancedTriangles or Primitives
    program_triangles : DeviceTriangles
    ids : HitIds
    masks : DeviceMasks
    """

    gpu: Gpu
    kernels: RayAnswers
    resident: Resident
    frame: SceneFrame
    triangles: Any
    program_triangles: DeviceTriangles
    ids: HitIds
    masks: DeviceMasks


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

    def __len__(self) -> int:
        return len(self.rays)

    def launch(
        self,
        kernel: RangeKernel,
        out: Any,
        *,
        status: np.uint64 | None = None,
        rows: slice | None = None,
    ) -> None:
        """Launch a kernel for each ray, or for some rows of them.

        Does not wait. `status` and the addresses in `out` are those of the first of these rays.
        """
        scene, tallies = self.scene, None
        start, end, _ = (rows or slice(None)).indices(len(self))
        if self._tallies is not None:
            tallies = self._tallies.address + np.uint64(start) * ROW
        source, tree = self.rays.source_from(start), scene.resident.tree
        if self.rays.worlds is not None:
            tree = tree._replace(worlds=moved(self.rays.worlds, start, 4))
        self.scope.follow()
        filter_ = scene.masks.filter_of(self.scope, self.rays.masks, start)
        shared = RayScene(source, scene.frame, tree, status, tallies, filter_)
        self.scope.launch(kernel, end - start, (shared, out))
