"""CudaBackend: the branching machine on CUDA, which traces one ray per thread."""

from __future__ import annotations

import operator
from functools import partial
from typing import TYPE_CHECKING, Any

from raystream.core.errors import RaystreamError
from raystream.core.query import Kind, Query
from raystream.core.rays import RayArrays, RayBatch
from raystream.cuda.bvh.kernels import layout_of, traced_as
from raystream.cuda.hit_ids import HitIds
from raystream.cuda.host_rays import trace_from_host
from raystream.cuda.launch import DeviceScene
from raystream.cuda.masks import DeviceMasks
from raystream.cuda.points import DevicePoints
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.payload import record_of
from raystream.cuda.queries import QUERIES, trace_on_device
from raystream.cuda.rays import usual_limits
from raystream.cuda.staging import StagingStreams
from raystream.cuda.structures import kernels_of, place
from raystream.cuda.triangles import DeviceTriangles
from raystream.jit.cuda import Gpu
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAccumulator, Sink
from raystream.machines.backend import Backend, Capabilities
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.cuda.rendering import CudaBands
    from raystream.kernels.point_queries import NearestArrays, PointBatch
    from raystream.rendering.integrator import RenderContext

#: Most rays from the host that are on the device together.
RAYS_AT_ONCE = 1 << 20


class CudaBackend(Backend):
    """Traces rays on a GPU, one per thread, with the CPU's traversals.

    Parameters
    ----------
    structure : Structure
        The arrays of its traversal are copied to the device.
    gpu : Gpu
    rays_at_once : int
        Most rays from the host that are on the device together: half of them are traced while
        the others are copied. Rays in device arrays are traced all together.

    Raises
    ------
    CudaError
        If the structure has no kernels, or there is not enough memory.
    ValueError
        If an option is out of range.
    """

    capabilities = Capabilities(device_arrays=True, shading=True, points=True, masks=True)

    def __init__(
        self,
        structure: Structure,
        gpu: Gpu,
        *,
        rays_at_once: int = RAYS_AT_ONCE,
    ) -> None:
        self.structure = structure
        self.gpu = gpu
        self.rays_at_once = operator.index(rays_at_once)
        if self.rays_at_once < 1:
            raise ValueError(f"rays_at_once: expected at least 1, got {rays_at_once}")
        self._scene = DeviceScene(
            gpu,
            kernels_of(traced_as(structure)),
            place(structure, gpu),
            structure.frame,
            structure.triangles,
            DeviceTriangles(gpu, structure.triangles),
            HitIds(gpu, structure.triangles),
            DeviceMasks(gpu, structure.triangles),
        )
        self._own_scene = None if layout_of(traced_as(structure)) else self._scene
        #: Whether the scene has triangles alone, where they are, in float32: for shading and
        #: programs.
        self._is_plain = not structure.triangles.kinds
        self._staging_streams = StagingStreams(gpu)
        self._points = DevicePoints(gpu, structure, self._scene.resident, self.rays_at_once)
        usual_limits(gpu)  # now, so that no query waits for them

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query of rays in host memory; see `Backend.run`."""
        query = query._replace(on_hit=None)
        trace = partial(self._trace, query, rays)
        if query.kind is Kind.MULTI_HIT:
            self.count_then_fill(query, rays, sink, progress, trace)
        else:
            trace(sink, progress)

    def run_program(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> bool:
        """Answer a query with its filter or program on the device, if it can run there."""
        if query.kind is Kind.ANY_HIT or not self._is_plain:
            return False
        goal, record = QUERIES[query.kind].goal, record_of(sink.records)
        if DeviceProgram.of(query.on_hit, goal, record).reason_against(self.gpu.capability):
            return False
        if query.kind is not Kind.MULTI_HIT:
            self._trace(query, rays, sink, progress)
            return True
        hits = HitAccumulator(len(rays))
        self._trace(query, rays, Sink(sink.status, visitor=hits.take), progress)
        sink.put(*hits.whole())
        return True

    def answer_on_device(
        self,
        query: Query,
        rays: RayArrays,
        progress: Progress | None = None,
        payload: Any = None,
    ) -> Any:
        """Answer a query of rays in device memory; see `trace_on_device`.

        Raises
        ------
        RaystreamError
            If it has a filter or a program, unless the scene is of triangles in float32.
        """
        if query.on_hit is not None and not self._is_plain:
            raise RaystreamError(
                "on_hit, skip_prim_ids: not supported for rays on a GPU, unless the scene is of "
                "triangles in float32 without instances; copy the rays to the host"
            )
        return trace_on_device(self._scene, query, rays, progress, payload)

    def find_nearest(
        self, batch: PointBatch, out: NearestArrays, progress: Progress | None = None
    ) -> None:
        """Find the triangles nearest to points in host memory; see `Backend.find_nearest`."""
        self._points.find(batch, out, progress)

    def bands_on_device(self, context: RenderContext) -> CudaBands | None:
        """Render samples of an image on the device; see `Tracer.bands_on_device`.

        With instances, spheres or height fields the host shades what queries find.
        """
        if not self._is_plain:
            return None
        from raystream.cuda.rendering import CudaBands

        return CudaBands(context, self._scene, self._staging_streams, self.rays_at_once)

    def _trace(self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None) -> None:
        # Counters are those of the CPU's nodes.
        scene = self._scene if sink.tallies is None else self._in_own_layout()
        own = scene, self._staging_streams, self.rays_at_once
        trace_from_host(*own, query, rays, sink, progress)

    def _in_own_layout(self) -> DeviceScene:
        """The scene with the structure's own arrays, copied when they are first needed."""
        if self._own_scene is None:
            kernels = kernels_of(traced_as(self.structure), is_own=True)
            resident = place(self.structure, self.gpu, is_own=True)
            self._own_scene = self._scene._replace(kernels=kernels, resident=resident)
        return self._own_scene
