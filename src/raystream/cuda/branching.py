"""The branching machine on CUDA: a thread takes a ray from start to end."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayArrays, RayBatch
from raystream.cuda.device_queries import DeviceScene
from raystream.cuda.device_rays import usual_limits
from raystream.cuda.parts import Answer, HostQuery, Part, trace_parts
from raystream.cuda.programs import HostRays, ProgramQueries
from raystream.cuda.staging import StagingStreams
from raystream.cuda.structures import kernel_for, kernels_of, place
from raystream.cuda.threads import RETRY, SeenTables
from raystream.cuda.triangles import DeviceTriangles
from raystream.jit.cuda import CudaError, Gpu
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses, HitArrays, Sink
from raystream.kernels.ray_source import ResultAddresses
from raystream.machines.backend import Backend, Capabilities
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.cuda.rendering import CudaBands
    from raystream.rendering.integrator import RenderContext

__all__ = ["Branching"]

#: Rays of the host's that are on the device together.
RAYS_AT_ONCE = 1 << 20

_NOWHERE = np.uint64(0)


class Branching(Backend):
    """Traces rays on a GPU, one a thread, with the CPU's traversals.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; what its traversal reads is copied to the device.
    gpu : Gpu
    rays_at_once : int
        Most rays of the host's that are on the device together: half of them are traced while
        the others are copied. Rays in arrays on the device are traced all together.
    kernel : {"auto", "compressed", "binary", "packet", "wide"}
        Of a BVH: how it is laid out on the device, and traced.
    launch : {"range", "persistent"}
        How threads get their rays: each has one; or as many as the device runs at once stay, and
        warps fetch more rays.
    order : {"given", "sorted"}
        Which rays the threads of a warp take: those that follow each other, or those that are
        alike, for which the device sorts them first; see `ray_order`. Answers come in the order
        of the rays.

    Raises
    ------
    CudaError
        If there are no kernels for the structure, or no memory for it.
    ValueError
        If an option is out of range.
    TypeError
        If `kernel` is given for a structure that is no BVH.
    """

    capabilities = Capabilities(device_arrays=True, shading=True)

    def __init__(
        self,
        structure: Structure,
        gpu: Gpu,
        *,
        rays_at_once: int = RAYS_AT_ONCE,
        kernel: str = "auto",
        launch: str = "range",
        order: str = "given",
    ) -> None:
        self.structure = structure
        self.gpu = gpu
        self.rays_at_once = operator.index(rays_at_once)
        if self.rays_at_once < 1:
            raise ValueError(f"rays_at_once: expected at least 1, got {rays_at_once}")
        kernel = kernel_for(structure, gpu, kernel)
        self._kernels = kernels_of(structure.name, kernel, launch, order)
        self._is_sorted = order == "sorted"
        self._resident = place(structure, gpu, kernel)
        self._in_order = DeviceTriangles(gpu, structure.triangles)
        self._staging_streams = StagingStreams(gpu)
        usual_limits(gpu)  # now, for no query should wait for them

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query of rays in the host's memory; see `Backend.run`."""
        frame = self.structure.frame
        if query.kind is Kind.MULTI_HIT:
            filled, half = self.room_for_hits(query, rays, sink, progress)
            self._multi_hit(HostQuery(query, rays, frame, filled, half))
            sink.put(filled.splits, filled.hits)
            return
        job = HostQuery(query, rays, frame, sink, progress)
        if query.kind is Kind.FIRST_HIT:
            self._first_hit(job)
        elif query.kind is Kind.ANY_HIT:
            self._any_hit(job)
        else:
            self._count_hits(job)

    def run_program(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> bool:
        """Answer a query with its filter or program on the device, if it can run there."""
        return HostRays(self._scene, self.rays_at_once).run(query, rays, sink, progress)

    def answer_on_device(
        self,
        query: Query,
        rays: RayArrays,
        progress: Progress | None = None,
        payload: Any = None,
    ) -> Any:
        """Answer a query of rays that are in the device's memory; see `ProgramQueries`."""
        return ProgramQueries(self._scene, query, rays).answer(progress, payload)

    @property
    def _scene(self) -> DeviceScene:
        structure = self.structure
        return DeviceScene(
            self.gpu,
            self._kernels,
            self._resident,
            structure.frame,
            structure.triangles,
            structure.has_duplicates,
            self._is_sorted,
            self._in_order,
        )

    def bands_on_device(self, context: RenderContext) -> CudaBands | None:
        """What takes samples of a picture on the device; see `Tracer.bands_on_device`."""
        from raystream.cuda.rendering import CudaBands

        own = self.gpu, self._kernels, self._resident, self.structure.frame, self._staging_streams
        return CudaBands(context, *own, self.rays_at_once, is_sorted=self._is_sorted)

    def _first_hit(self, job: HostQuery) -> None:
        out = job.sink.hits

        def answer(part: Part, _tables: SeenTables) -> Callable[[], bool]:
            hits = part.empty("hits", (4, part.count), np.float32)
            t, u, v, prim_id = _rows(hits.address, part.count)
            to = ResultAddresses(t, u, v, prim_id, _NOWHERE, part.status)
            part.run(self._kernels.first_hit, to)
            rows = part.staging.download(hits)

            def take() -> bool:
                _copy(rows, out.part(part.rows))
                return True

            return take

        self._trace(job, answer)

    def _any_hit(self, job: HostQuery) -> None:
        seen = job.sink.seen

        def answer(part: Part, _tables: SeenTables) -> Callable[[], bool]:
            found = part.empty("answers", part.count, np.bool_)
            nowhere = _NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE
            to = ResultAddresses(*nowhere, found.address, part.status)
            part.run(self._kernels.any_hit, to)
            answers = part.staging.download(found)

            def take() -> bool:
                seen[part.rows] = answers
                return True

            return take

        self._trace(job, answer)

    def _count_hits(self, job: HostQuery) -> None:
        counts, query = job.sink.counts, job.query

        def answer(part: Part, tables: SeenTables) -> Callable[[], bool]:
            found = part.empty("counts", part.count, np.int64)
            wanted = bool(query.surfaces), np.uint64(query.limit)
            part.run(self._kernels.count_hits, tables, *wanted, part.status, found.address)
            own = part.staging.download(found)

            def take() -> bool:
                counts[part.rows] = own
                return not (own == RETRY).any()

            return take

        self._trace(job, answer, has_duplicates=self.structure.has_duplicates)

    def _multi_hit(self, job: HostQuery) -> None:
        splits, out, surfaces = job.sink.splits, job.sink.hits, bool(job.query.surfaces)

        def answer(part: Part, tables: SeenTables) -> Callable[[], bool]:
            wanted = splits[part.rows.start : part.rows.stop + 1]
            rows = slice(int(wanted[0]), int(wanted[-1]))
            own = part.upload("splits", wanted - wanted[0])
            hits = part.empty("hits", (4, rows.stop - rows.start), np.float32)
            found = part.empty("counts", part.count, np.int64)
            t, u, v, prim_id = _rows(hits.address, rows.stop - rows.start)
            to = HitAddresses(t, u, v, prim_id)
            part.run(self._kernels.multi_hit, tables, surfaces, own.address, to, found.address)
            counts, columns = part.staging.download(found), part.staging.download(hits)

            def take() -> bool:
                if (counts == RETRY).any():
                    return False
                if not np.array_equal(counts, np.diff(wanted)):
                    raise CudaError(
                        f"device 'cuda': {self.gpu.name} found fewer hits than it had counted"
                    )
                _copy(columns, out.part(rows))
                return True

            return take

        has_duplicates = self.structure.has_duplicates
        self._trace(job, answer, has_duplicates=has_duplicates, splits=splits)

    def _trace(self, job: HostQuery, answer: Answer, **options: Any) -> None:
        shared = self.gpu, self._resident, self._staging_streams, self.rays_at_once
        trace_parts(job, *shared, answer, is_sorted=self._is_sorted, **options)


def _rows(address: np.uint64, count: int) -> list[np.uint64]:
    """Addresses of four rows of `count` words."""
    return [address + np.uint64(4 * count * k) for k in range(4)]


def _copy(rows: Any, out: HitArrays) -> None:
    for column, row in zip(out, HitArrays.rows_of(rows), strict=True):
        column[:] = row
