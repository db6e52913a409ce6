"""The branching machine on CUDA: a thread takes a ray from start to end."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.cuda.device_queries import DeviceScene
from raystream.cuda.device_rays import usual_limits
from raystream.cuda.lanes import Lanes
from raystream.cuda.parts import Answer, Asked, Part, trace_parts
from raystream.cuda.programs import HostRays, ProgramQueries
from raystream.cuda.structures import kernel_for, kernels_of, place
from raystream.cuda.threads import RETRY, SeenTables
from raystream.cuda.triangles import TrianglesThere
from raystream.jit.cuda import CudaError, Gpu
from raystream.jit.threads import Progress, part_of
from raystream.kernels.collect import HitAddresses, HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays
from raystream.kernels.ray_source import ResultAddresses
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries
from raystream.structures.found import allocate_hits

if TYPE_CHECKING:
    from raystream.cuda.rendering import CudaBands
    from raystream.rendering.sampled import Setting

__all__ = ["Branching"]

#: Rays of the host's that are on the device together.
RAYS_AT_ONCE = 1 << 20

_NOWHERE = np.uint64(0)


class Branching(BatchQueries):
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
        self._identity = SceneFrame.identity(structure.triangles)
        self._in_order = TrianglesThere(gpu, structure.triangles)
        self._lanes = Lanes(gpu)
        usual_limits(gpu)  # now, for no query should wait for them

    @property
    def frame(self) -> SceneFrame:
        """The frame of the structure's triangles."""
        return self.structure.frame

    def on_device(
        self, on_hit: Any, skip_prim_ids: Any, origins: Any, directions: Any, t_min: Any, t_max: Any
    ) -> ProgramQueries:
        """Answer for rays that are in the device's memory; see `ProgramQueries`."""
        return ProgramQueries(self._scene, on_hit, skip_prim_ids, origins, directions, t_min, t_max)

    @property
    def programs_there(self) -> HostRays | None:
        """What runs programs for rays of the host's."""
        return HostRays(self._scene, self.rays_at_once)

    @property
    def _scene(self) -> DeviceScene:
        structure = self.structure
        return DeviceScene(
            self.gpu,
            self._kernels,
            self._resident,
            self.frame,
            structure.triangles,
            structure.lists_twice,
            self._is_sorted,
            self._in_order,
        )

    def bands_on_device(self, setting: Setting) -> CudaBands | None:
        """What takes samples of a picture on the device; see `Queries.bands_on_device`."""
        from raystream.cuda.rendering import CudaBands

        own = self.gpu, self._kernels, self._resident, self.frame, self._lanes
        return CudaBands(setting, *own, self.rays_at_once, is_sorted=self._is_sorted)

    # ---- Whole batches, in world space.

    def first_hit_batch(
        self,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> HitArrays:
        """Find the nearest hit of each ray; see `BatchQueries.first_hit_batch`."""
        out = HitArrays.empty(len(batch))
        self._first_hit(Asked(batch, self.frame, status, progress, tallies), out)
        return out

    def any_hit_batch(
        self,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; see `BatchQueries.any_hit_batch`."""
        return self._any_hit(Asked(batch, self.frame, status, progress, tallies))

    def count_hits_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray; see `BatchQueries.count_hits_batch`."""
        asked = Asked(batch, self.frame, status, progress, tallies)
        return self._count_hits(asked, surfaces, limit)

    def multi_hit_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> tuple[NDArray[np.int64], HitArrays]:
        """Find the nearest hits of each ray; see `BatchQueries.multi_hit_batch`."""
        splits = np.zeros(len(batch) + 1, np.int64)
        if limit:
            first_half = part_of(progress, 0, 2 * len(batch))
            counts = self.count_hits_batch(batch, surfaces, limit, status, first_half, tallies)
            np.cumsum(counts, out=splits[1:])
        else:
            self.any_hit_batch(batch, status)  # it tells which rays are invalid
        hits = allocate_hits(int(splits[-1]))
        second_half = part_of(progress, len(batch), 2 * len(batch))
        asked = Asked(batch, self.frame, status, second_half, tallies)
        self._multi_hit(asked, surfaces, splits, hits)
        return splits, hits

    # ---- Local rays: those of the identity's frame.

    def first_hit(
        self,
        rays: LocalRays,
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Find the nearest hit of each ray; see `BatchQueries.first_hit`."""
        self._first_hit(self._local(rays, progress, tallies), out)

    def any_hit(
        self,
        rays: LocalRays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; see `BatchQueries.any_hit`."""
        return self._any_hit(self._local(rays, progress, tallies))

    def count_hits(
        self,
        rays: LocalRays,
        surfaces: bool,
        limit: int = UNLIMITED,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray; see `BatchQueries.count_hits`."""
        return self._count_hits(self._local(rays, progress, tallies), surfaces, limit)

    def multi_hit(
        self,
        rays: LocalRays,
        surfaces: bool,
        splits: NDArray[np.int64],
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Write the nearest hits of each ray; see `BatchQueries.multi_hit`."""
        self._multi_hit(self._local(rays, progress, tallies), surfaces, splits, out)

    def _local(
        self, rays: LocalRays, progress: Progress | None, tallies: NDArray[np.uint32] | None
    ) -> Asked:
        batch = RayBatch(rays.origins, rays.directions, rays.t_min, rays.t_max)
        return Asked(batch, self._identity, np.zeros(len(batch), np.uint8), progress, tallies)

    # ---- What both come to.

    def _first_hit(self, asked: Asked, out: HitArrays) -> None:
        def answer(part: Part, _tables: SeenTables) -> Callable[[], bool]:
            hits = part.empty("hits", (4, part.count), np.float32)
            t, u, v, prim_id = _rows(hits.address, part.count)
            to = ResultAddresses(t, u, v, prim_id, _NOWHERE, part.status)
            part.run(self._kernels.first_hit, to)
            rows = part.lane.download(hits)

            def take() -> bool:
                _copy(rows, out.part(part.rows))
                return True

            return take

        self._trace(asked, answer)

    def _any_hit(self, asked: Asked) -> NDArray[np.bool_]:
        seen = np.empty(len(asked.batch), np.bool_)

        def answer(part: Part, _tables: SeenTables) -> Callable[[], bool]:
            found = part.empty("answers", part.count, np.bool_)
            nowhere = _NOWHERE, _NOWHERE, _NOWHERE, _NOWHERE
            to = ResultAddresses(*nowhere, found.address, part.status)
            part.run(self._kernels.any_hit, to)
            answers = part.lane.download(found)

            def take() -> bool:
                seen[part.rows] = answers
                return True

            return take

        self._trace(asked, answer)
        return seen

    def _count_hits(self, asked: Asked, surfaces: bool, limit: int) -> NDArray[np.int64]:
        counts = np.empty(len(asked.batch), np.int64)

        def answer(part: Part, tables: SeenTables) -> Callable[[], bool]:
            found = part.empty("counts", part.count, np.int64)
            wanted = bool(surfaces), np.uint64(limit)
            part.run(self._kernels.count_hits, tables, *wanted, part.status, found.address)
            own = part.lane.download(found)

            def take() -> bool:
                counts[part.rows] = own
                return not (own == RETRY).any()

            return take

        self._trace(asked, answer, lists_twice=self.structure.lists_twice)
        return counts

    def _multi_hit(
        self, asked: Asked, surfaces: bool, splits: NDArray[np.int64], out: HitArrays
    ) -> None:
        def answer(part: Part, tables: SeenTables) -> Callable[[], bool]:
            wanted = splits[part.rows.start : part.rows.stop + 1]
            rows = slice(int(wanted[0]), int(wanted[-1]))
            own = part.upload("splits", wanted - wanted[0])
            hits = part.empty("hits", (4, rows.stop - rows.start), np.float32)
            found = part.empty("counts", part.count, np.int64)
            t, u, v, prim_id = _rows(hits.address, rows.stop - rows.start)
            to = HitAddresses(t, u, v, prim_id)
            more = bool(surfaces), own.address, to, found.address
            part.run(self._kernels.multi_hit, tables, *more)
            counts, columns = part.lane.download(found), part.lane.download(hits)

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

        lists_twice = self.structure.lists_twice
        self._trace(asked, answer, lists_twice=lists_twice, splits=splits)

    def _trace(self, asked: Asked, answer: Answer, **options: Any) -> None:
        shared = self.gpu, self._resident, self._lanes, self.rays_at_once
        trace_parts(asked, *shared, answer, is_sorted=self._is_sorted, **options)


def _rows(address: np.uint64, count: int) -> list[np.uint64]:
    """Addresses of four rows of `count` words."""
    return [address + np.uint64(4 * count * k) for k in range(4)]


def _copy(rows: NDArray[np.float32], out: HitArrays) -> None:
    for column, row in zip(out, HitArrays.rows_of(rows), strict=True):
        column[:] = row
