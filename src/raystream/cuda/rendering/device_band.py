"""DeviceBand: rows of one sample of an image, with paths in GPU memory."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.rays import usual_limits
from raystream.cuda.rendering.columns import StreamColumns
from raystream.cuda.rendering.kernels import generate_camera_rays
from raystream.cuda.rendering.slots import Slots
from raystream.cuda.rendering.tables import TableMemory
from raystream.jit.cuda import RangeKernel
from raystream.kernels.hits import HitAddresses
from raystream.kernels.queries import RayScene
from raystream.rendering.camera_paths import camera_paths
from raystream.rendering.integrator import RenderContext
from raystream.rendering.sampling.sampler import PixelSample
from raystream.rendering.shading.camera_rays import View, view_of
from raystream.rendering.shading.streams import ShadingBatch

if TYPE_CHECKING:
    from raystream.cuda.launch import DeviceScene
    from raystream.cuda.staging import StagingStream


class RenderScene:
    """A scene and a renderer's tables on a device.

    Parameters
    ----------
    queries : DeviceScene
    context : RenderContext

    Attributes
    ----------
    sampler : Sampler
    view : View or None
        None for cameras whose paths begin on the host.
    """

    def __init__(self, queries: DeviceScene, context: RenderContext) -> None:
        self.queries, self.gpu, self.context = queries, queries.gpu, context
        self.sampler = context.sampler
        self.view: View | None = None
        if context.camera.projection == "perspective":
            self.view = view_of(context.camera, context.width, context.height)
        self._memory = TableMemory(self.gpu, context.kept)
        self._placed: dict[str, Any] = {}
        self._lock = threading.Lock()

    def table(self, name: str) -> Any:
        """The context's ``tables``, ``lights`` or ``punctual``, copied on first use.

        Raises
        ------
        CudaError
            If there is no memory for them.
        """
        with self._lock:
            if name not in self._placed:
                self._placed[name] = self._memory.placed(getattr(self.context, name))
                self.gpu.wait()  # staging streams do not wait for the default stream
            return self._placed[name]


@dataclass(frozen=True)
class ShadowStream:
    """Shadow rays to be traced.

    Attributes
    ----------
    slots : Slots
        Where threads wrote them.
    rays : StreamColumns
        The rays, compacted.
    thread_count, ray_count : int
        Threads that wrote rays, and rays.
    """

    slots: Slots
    rays: StreamColumns
    thread_count: int
    ray_count: int


@dataclass(frozen=True)
class DeviceStream:
    """Active paths; see `rendering.integrator.PathStream`.

    Attributes
    ----------
    paths : StreamColumns
    count : int
        Of paths.
    bounce : int
    hits : HitAddresses, optional
    shadows : ShadowStream, optional
    """

    paths: StreamColumns
    count: int
    bounce: int = 0
    hits: HitAddresses | None = None
    shadows: ShadowStream | None = None


class DeviceBand:
    """Rows of one sample of an image, with memory for their paths.

    Parameters
    ----------
    scene : RenderScene
    staging : StagingStream
        Where kernels are launched.
    rows : range
    sample : int

    Attributes
    ----------
    count : int
        Pixels.
    radiance : uint64
        Address of their radiance, to which stages add.

    Raises
    ------
    CudaError
        If there is no memory for it.
    """

    def __init__(
        self, scene: RenderScene, staging: StagingStream, rows: range, sample: int
    ) -> None:
        self.scene, self._staging, self._rows = scene, staging, rows
        width = scene.context.width
        self.count = len(rows) * width
        self.sample, self.first_pixel = sample, rows.start * width
        self._radiance = staging.cleared("light", (self.count, 3), np.float32)
        self.radiance = self._radiance.address
        self.empty = staging.empty
        self._shadow_rays: tuple[Slots, StreamColumns] | None = None
        limits = usual_limits(scene.gpu)
        self._limits = limits[0.0].address, limits[np.inf].address

    @cached_property
    def hits(self) -> HitAddresses:
        """Memory for the nearest hits of the paths' rays."""
        self._hits = self.empty("hits", (4, self.count), np.float32)
        return HitAddresses.of_rows(self._hits.address, self.count)

    @cached_property
    def onward(self) -> Slots:
        """Slots for paths that continue."""
        return Slots(self.scene.gpu, self._staging, self.count, 1)

    def shadow_rays(self, per_thread: int) -> tuple[Slots, StreamColumns]:
        """Slots for shadow rays, at most `per_thread` per path, and columns to compact them to."""
        if self._shadow_rays is None:
            slots = Slots(self.scene.gpu, self._staging, self.count, per_thread)
            self._shadow_rays = slots, StreamColumns(self.empty, slots.row_count)
        return self._shadow_rays

    def batch(self, stream: DeviceStream) -> ShadingBatch:
        """The paths with their hits, for shading kernels."""
        assert stream.hits is not None
        places = stream.paths.addresses, stream.hits
        return ShadingBatch(stream.count, *places, self.first_pixel, self.radiance)

    def run(self, kernel: RangeKernel, count: int, *arguments: Any) -> None:
        """Launch a kernel asynchronously."""
        kernel.launch(self.scene.gpu, count, arguments, self._staging.stream.native)

    def trace(
        self, kernel: RangeKernel, rays: StreamColumns, count: int, has_ends: bool, to: Any
    ) -> None:
        """Launch a query of rays that writes to `to`."""
        status = self.empty("status", count, np.uint8)  # not read
        source, held = rays.source(*self._limits, has_ends), self.scene.queries
        shared = source, held.frame, held.resident.tree, status.address
        self.run(kernel, count, RayScene(*shared, None, None), to)

    def wait(self) -> None:
        """Wait until all launches are done."""
        self._staging.finish()

    def camera_paths(self) -> DeviceStream:
        """Begin a path at each pixel; see `rendering.camera_paths.camera_paths`."""
        scene, context = self.scene, self.scene.context
        if scene.view is None:
            size = context.width, context.height
            paths = camera_paths(context.camera, size, context.sampler, self._rows, self.sample)
            return DeviceStream(StreamColumns.copied(self._staging.upload, paths), self.count)
        columns = StreamColumns(self.empty, self.count)
        given = self._rows.start, PixelSample(scene.sampler, self.sample), columns.addresses
        self.run(generate_camera_rays, self.count, scene.view, *given)
        return DeviceStream(columns, self.count)

    def read(self) -> NDArray[np.float32]:
        """Wait for all launches, and read the radiance."""
        light = self._staging.download(self._radiance)
        self.wait()
        return light.copy()
