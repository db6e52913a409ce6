"""DeviceBand: rows of a picture in one sample, whose paths are in a GPU's memory."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.ray_order import sort_rays
from raystream.cuda.rays import usual_limits
from raystream.cuda.rendering.columns import HitColumns, StreamColumns
from raystream.cuda.rendering.kernels import BEGIN
from raystream.cuda.rendering.slots import Slots
from raystream.cuda.rendering.tables import TableMemory, plain
from raystream.jit.constants import NULL
from raystream.jit.cuda import Gpu, RangeKernel
from raystream.kernels.ray_source import ResultAddresses
from raystream.rendering.integrator import RenderContext, camera_paths
from raystream.rendering.shading.camera_rays import view_of

if TYPE_CHECKING:
    from raystream.cuda.query_kernels import QueryKernels
    from raystream.cuda.staging import StagingStream
    from raystream.cuda.structures import Resident
    from raystream.kernels.ray import SceneFrame

__all__ = ["DeviceBand", "DeviceScene", "DeviceStream"]


class DeviceScene:
    """What a device knows of a picture.

    Parameters
    ----------
    gpu : Gpu
    kernels : QueryKernels
    resident : Resident
        The structure.
    frame : SceneFrame
    is_sorted : bool
        Whether the kernels take rays in the order of their keys.
    setting : RenderContext

    Attributes
    ----------
    sampler : Sampler
    view : View or None
        None of cameras whose paths begin on the host.
    """

    def __init__(
        self,
        gpu: Gpu,
        kernels: QueryKernels,
        resident: Resident,
        frame: SceneFrame,
        is_sorted: bool,
        setting: RenderContext,
    ) -> None:
        self.gpu, self.kernels, self.resident, self.frame = gpu, kernels, resident, frame
        self.is_sorted = is_sorted
        self.setting = setting
        self.sampler: Any = plain(setting.sampler)
        self.view: Any = None
        if setting.camera.projection == "perspective":
            self.view = plain(view_of(setting.camera, setting.width, setting.height))
        self._memory = TableMemory(gpu, setting.kept)
        self._placed: dict[str, Any] = {}
        self._lock = threading.Lock()

    def table(self, name: str) -> Any:
        """The setting's ``tables``, ``lights`` or ``punctual``, copied when first asked for.

        Raises
        ------
        CudaError
            If there is no memory for what they point to.
        """
        with self._lock:
            if name not in self._placed:
                self._placed[name] = self._memory.placed(getattr(self.setting, name))
                self.gpu.wait()  # for whom staging streams do not
            return self._placed[name]


@dataclass(frozen=True)
class DeviceStream:
    """Paths on their way; see `rendering.integrator.PathStream`.

    Attributes
    ----------
    paths : StreamColumns
    count : int
        Of these.
    bounce : int
    hits : HitColumns, optional
    asked : tuple of Slots and StreamColumns, optional
        Rays to lights that are to be tested: where they were written, and where they are.
    asked_count, ray_count : int
        Threads that wrote them, and how many there are.
    """

    paths: StreamColumns
    count: int
    bounce: int = 0
    hits: HitColumns | None = None
    asked: tuple[Slots, StreamColumns] | None = None
    asked_count: int = 0
    ray_count: int = 0


class DeviceBand:
    """Rows of a picture in one sample, with memory for their paths.

    Parameters
    ----------
    scene : DeviceScene
    staging : StagingStream
        In whose stream all is done.
    rows : range
    sample : int

    Attributes
    ----------
    count : int
        Pixels.
    radiance : uint64
        Address of their light, to which stages add.

    Raises
    ------
    CudaError
        If there is no memory for it.
    """

    def __init__(
        self, scene: DeviceScene, staging: StagingStream, rows: range, sample: int
    ) -> None:
        self.scene, self._staging, self._rows = scene, staging, rows
        width = scene.setting.width
        self.count = len(rows) * width
        self.sample = np.int64(sample)
        self.first_pixel = np.int64(rows.start * width)
        self._radiance = staging.cleared("light", (self.count, 3), np.float32)
        self.radiance = self._radiance.address
        self.empty = staging.empty
        self._room: tuple[Slots, StreamColumns] | None = None
        limits = usual_limits(scene.gpu)
        self._limits = limits[0.0].address, limits[np.inf].address

    @cached_property
    def hits(self) -> HitColumns:
        """Room for the paths' hits."""
        return HitColumns(self.empty, self.count)

    @cached_property
    def onward(self) -> Slots:
        """Room for paths that threads send on."""
        return Slots(self.scene.gpu, self._staging, self.count, 1)

    def room_for_rays(self, each: int) -> tuple[Slots, StreamColumns]:
        """Room for rays to lights: where threads write them, so many each, and without gaps."""
        if self._room is None:
            slots = Slots(self.scene.gpu, self._staging, self.count, each)
            self._room = slots, StreamColumns(self.empty, slots.most)
        return self._room

    def run(self, kernel: RangeKernel, count: int, *arguments: Any) -> None:
        """Begin to run a kernel."""
        kernel.launch(self.scene.gpu, count, arguments, self._staging.stream.native)

    def ask(
        self, kernel: RangeKernel, rays: StreamColumns, count: int, has_ends: bool, **to: np.uint64
    ) -> None:
        """Begin a query for rays; `to` says where the answers go."""
        status = self.empty("status", count, np.uint8)  # nobody reads it
        places = dict.fromkeys(ResultAddresses._fields, NULL) | to
        places["status"] = status.address
        source = rays.source(*self._limits, has_ends)
        scene, answers = self.scene, ResultAddresses(**places)
        shared = source, scene.frame, scene.resident.tree, None, answers
        if not scene.is_sorted:
            self.run(kernel, count, *shared)
            return
        own = self.empty, self._staging.stream
        order = sort_rays(scene.gpu, source, count, scene.frame, *own)
        self.run(kernel, count, order.address, *shared)

    def wait(self) -> None:
        """Wait until all that was begun is done."""
        self._staging.finish()

    def camera_paths(self) -> DeviceStream:
        """Begin a path at each pixel; see `rendering.integrator.camera_paths`."""
        scene, setting = self.scene, self.scene.setting
        if scene.view is None:
            size = setting.width, setting.height
            paths = camera_paths(
                setting.camera, size, setting.sampler, self._rows, int(self.sample)
            )
            return DeviceStream(StreamColumns.copied(self._staging.upload, paths), self.count)
        columns = StreamColumns(self.empty, self.count)
        first_row = np.int64(self._rows.start)
        numbers = scene.sampler, self.sample
        self.run(BEGIN, self.count, scene.view, first_row, *numbers, columns.addresses)
        return DeviceStream(columns, self.count)

    def read(self) -> NDArray[np.float32]:
        """The light, when all is done."""
        light = self._staging.download(self._radiance)
        self.wait()
        return light.copy()
