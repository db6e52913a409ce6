"""The queries on CUDA: the kernels that each kind launches, and its answers on the device.

They serve rays in device memory (`trace_on_device`) and parts of a batch in host memory
(`host_rays.trace_from_host`) alike, with or without a filter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import closing
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.masks import ray_masks
from raystream.core.query import Kind, Query
from raystream.core.rays import RayArrays
from raystream.cuda.device_hits import DeviceHits, DeviceMultiHits
from raystream.cuda.launch import DeviceScene, RayLauncher, Steps, resume
from raystream.cuda.programs.payload import place_payload
from raystream.cuda.programs.rounds import ProgramRounds
from raystream.cuda.programs.steps import note_hits, note_invalid
from raystream.cuda.rays import host_values, place_device_rays
from raystream.cuda.scan import prefix_sum
from raystream.jit.cuda import CudaError, DeviceArray, StreamScope, stream_of
from raystream.jit.threads import Progress
from raystream.kernels.hits import HitAddresses, HitArrays, HitBatch, Sink
from raystream.kernels.queries import CountAddresses, RowAddresses
from raystream.programs.loop_source import Goal

__all__ = ["QUERIES", "DeviceQuery", "trace_on_device"]

#: Rows of hits begin at multiples of this many numbers, as separate arrays would: 256 bytes.
_ROW_ALIGNMENT = 64


class HitBlock(NamedTuple):
    """Hits on a device: four rows t, u, v and prim_id of one array.

    Attributes
    ----------
    block : DeviceArray of shape (4, M), float32 or float64
        With M >= `hit_count`; prim_id are bits of the last row, from its beginning on.
    hit_count : int
    """

    block: DeviceArray
    hit_count: int

    @classmethod
    def empty(cls, rays: RayLauncher, count: int) -> HitBlock:
        """Allocate uninitialised rows, of the precision of the rays' scene."""
        length = -(-count // _ROW_ALIGNMENT) * _ROW_ALIGNMENT
        kind = rays.scene.triangles.number_type
        return cls(rays.scope.empty("hits", (4, length), kind), count)

    @property
    def addresses(self) -> HitAddresses:
        """Where kernels write."""
        return HitAddresses.of_rows(
            self.block.address, self.block.shape[1], self.block.dtype.itemsize
        )

    def columns(
        self, shape: tuple[int, ...]
    ) -> tuple[DeviceArray, DeviceArray, DeviceArray, DeviceArray]:
        """The rows as separate arrays."""
        length = self.block.shape[1]
        t, u, v, bits = (
            self.block.part(k * length, self.hit_count).shaped(shape) for k in range(4)
        )
        return t, u, v, bits.shaped(shape, np.int32)

    def rows_of(self, copy: NDArray[Any]) -> HitArrays:
        """The rows of a copy of the block on the host."""
        t, u, v, bits = copy[:, : self.hit_count]
        return HitArrays(t, u, v, bits.view(np.int32)[: self.hit_count])

    def copy_rows(self, copy: NDArray[Any], out: HitArrays) -> None:
        """Write a copy of the block to arrays on the host."""
        for column, values in zip(out, self.rows_of(copy), strict=True):
            column[:] = values


class DeviceQuery(ABC):
    """A query of rays on a device: one subclass per kind.

    Parameters
    ----------
    query : Query
        A filter's skipped triangles are those of these rays, as the caller gave them.
    rays : RayLauncher
    payload : array, dtype or None
        For `Kind.TRACE`, see `place_payload`.
    splits : ndarray of shape (N + 1,), int64, optional
        For `Kind.MULTI_HIT`, if the hits have been counted: ray i owns rows splits[i] to
        splits[i + 1] of the sink.

    Attributes
    ----------
    goal : str
        What the kernel of a filter or program does with hits.
    pass_count : int
        Steps per ray that progress reports.
    status : DeviceArray of shape (N,), uint8
        A `RayStatus` for each ray.
    """

    goal: ClassVar[Goal]
    pass_count: ClassVar[int] = 1
    status: DeviceArray

    def __init__(
        self,
        query: Query,
        rays: RayLauncher,
        *,
        payload: Any = None,
        splits: NDArray[np.int64] | None = None,
    ) -> None:
        self.query, self.rays = query, rays
        self.scope, self.scene = rays.scope, rays.scene
        self._payload, self._splits = payload, splits

    @abstractmethod
    def launch(self) -> Steps[None]:
        """Launch the kernels.

        Raises
        ------
        TypeError
            If the filter or program does not run on the device.
        CudaError
            If there is no memory for the answers.
        """

    @property
    @abstractmethod
    def outputs(self) -> tuple[DeviceArray, ...]:
        """The answers on the device."""

    @abstractmethod
    def result(self) -> Any:
        """The answers as the tracer returns them for rays in device memory."""

    @abstractmethod
    def store(self, copies: Sequence[NDArray[Any]], sink: Sink, rows: slice) -> None:
        """Write copies of `outputs` to the rows of a sink."""

    def _cleared(self, name: str, dtype: Any) -> DeviceArray:
        return self.scope.cleared(name, len(self.rays), dtype)

    def _shaped(self, array: DeviceArray) -> DeviceArray:
        return array.shaped(self.rays.rays.shape)

    def _hits(self, hits: HitBlock, shape: tuple[int, ...]) -> tuple[Any, ...]:
        """The arguments of results with hits, in order, besides the first one of several."""
        t, u, v, numbers = hits.columns(shape)
        prim_id, instance_id = self.scene.ids.split(self.scope, numbers)
        status, triangles = self._shaped(self.status), self.scene.triangles
        return t, u, v, prim_id, status, triangles, instance_id

    def _program(self) -> ProgramRounds | None:
        """The rounds of the filter, if the query has one."""
        if self.query.on_hit is None or self.query.limit == 0:
            return None
        return ProgramRounds.of(self.rays, self.query, self.goal)

    def _count(self, limit: int) -> DeviceArray:
        """Count the hits of each ray, at most `limit`, and write the status."""
        counts = self.scope.empty("counts", len(self.rays), np.int64)
        to = CountAddresses.of(self.query._replace(limit=limit), counts.address)
        self.rays.launch(self.scene.kernels.count_hits, to, status=self.status.address)
        return counts


class FirstHit(DeviceQuery):
    """The nearest hit of each ray."""

    goal = "first"

    def launch(self) -> Steps[None]:
        program = self._program()
        self.hits = HitBlock.empty(self.rays, len(self.rays))
        self.status = self._cleared("status", np.uint8)
        kernel, to = self.scene.kernels.first_hit, self.hits.addresses
        self.rays.launch(kernel, to, status=self.status.address)
        if program is not None:
            yield from program.replace_rejected(self.hits.addresses)

    @property
    def outputs(self) -> tuple[DeviceArray, ...]:
        return self.hits.block, self.status

    def result(self) -> DeviceHits:
        return DeviceHits(*self._hits(self.hits, self.rays.rays.shape))

    def store(self, copies: Sequence[NDArray[Any]], sink: Sink, rows: slice) -> None:
        self.hits.copy_rows(copies[0], sink.hits.part(rows))
        sink.status[rows] = copies[1]


class _OneNumber(DeviceQuery):
    """A query with a number for each ray.

    Attributes
    ----------
    column : str
        The numbers' attribute in a sink.
    numbers : DeviceArray of shape (N,)
    """

    column: ClassVar[str]
    numbers: DeviceArray

    @property
    def outputs(self) -> tuple[DeviceArray, ...]:
        return self.numbers, self.status

    def result(self) -> DeviceArray:
        return self._shaped(self.numbers)

    def store(self, copies: Sequence[NDArray[Any]], sink: Sink, rows: slice) -> None:
        getattr(sink, self.column)[rows], sink.status[rows] = copies


class AnyHit(_OneNumber):
    """Whether each ray hits anything; with a filter, whether it has a nearest hit."""

    goal, column = "first", "seen"

    def launch(self) -> Steps[None]:
        if self.query.on_hit is None:
            self.numbers = self.scope.empty("answers", len(self.rays), np.bool_)
            self.status = self._cleared("status", np.uint8)
            kernel = self.scene.kernels.any_hit
            self.rays.launch(kernel, self.numbers.address, status=self.status.address)
            return
        nearest = FirstHit(self.query, self.rays)
        yield from nearest.launch()
        self.status = nearest.status
        self.numbers = self.scope.empty("answers", len(self.rays), np.bool_)
        to_seen = nearest.hits.addresses.prim_id, self.numbers
        self.scope.launch(note_hits, len(self.rays), to_seen)


class CountHits(_OneNumber):
    """The number of hits of each ray."""

    goal, column = "count", "counts"

    def launch(self) -> Steps[None]:
        program = self._program()
        self.status = self._cleared("status", np.uint8)
        if program is None:
            self.numbers = self._count(self.query.limit)
        else:
            self.numbers = self._cleared("counts", np.int64)
            yield from program.count_into(self.numbers)


class MultiHit(DeviceQuery):
    """The nearest `limit` hits of each ray, by t, then prim_id."""

    goal = "keep"
    pass_count = 2

    def launch(self) -> Steps[None]:
        if self._splits is not None:
            self._launch_counted(self._splits)
            return
        program, limit = self._program(), self.query.limit
        self.status = self._cleared("status", np.uint8)
        if program is None:
            # Also of rays that want no hits: it finds the invalid ones.
            counts = self._count(max(limit, 1))
            if limit == 0:
                self.scope.gpu.clear(counts, self.scope.stream)
        else:
            arguments = self.rays.rays.source, self.scene.frame, self.status
            self.scope.launch(note_invalid, len(self.rays), arguments)
            counts = yield from program.count_kept(limit)
        self.splits = prefix_sum(self.scope, counts)
        (total,) = yield (self.splits.part(len(self.rays), 1),)
        self.rays.report(1, self.pass_count)
        self.hits = HitBlock.empty(self.rays, int(total[0]))
        if not total[0]:
            return
        if program is None:
            self._write()
        else:
            yield from program.keep_rows(limit, self.splits, self.hits.addresses)

    def _launch_counted(self, splits: NDArray[np.int64]) -> None:
        """Find hits that have been counted."""
        self.splits = self.scope.placed("splits", splits - splits[0])
        self.hits = HitBlock.empty(self.rays, int(splits[-1] - splits[0]))
        self._write()

    def _write(self) -> None:
        """Write the hits of each ray to its rows."""
        self.found = self.scope.empty("counts", len(self.rays), np.int64)
        splits, found = self.splits.address, self.found.address
        to = RowAddresses(self.query.surfaces, splits, self.hits.addresses, found)
        self.rays.launch(self.scene.kernels.multi_hit, to)

    @property
    def outputs(self) -> tuple[DeviceArray, ...]:
        if self._splits is not None:
            return self.hits.block, self.found
        return self.hits.block, self.splits, self.status

    def result(self) -> DeviceMultiHits:
        return DeviceMultiHits(self.splits, *self._hits(self.hits, (self.hits.hit_count,)))

    def store(self, copies: Sequence[NDArray[Any]], sink: Sink, rows: slice) -> None:
        if self._splits is not None:
            block, found = copies
            if not np.array_equal(found, np.diff(self._splits)):
                raise CudaError(
                    f"device 'cuda': {self.scene.gpu.name} found fewer hits than it had counted"
                )
            own = slice(int(self._splits[0]), int(self._splits[-1]))
            self.hits.copy_rows(block, sink.hits.part(own))
            return
        block, splits, sink.status[rows] = copies
        assert sink.visitor is not None
        hits = self.hits.rows_of(block)
        sink.visitor(HitBatch(hits, splits, None, rows.start))


class Trace(DeviceQuery):
    """A program at the hits of each ray, with a payload."""

    goal = "trace"

    def launch(self) -> Steps[None]:
        self._placed = place_payload(self.scope, self._payload, self.rays.rays.shape)
        record = self._placed.record
        program = ProgramRounds.of(self.rays, self.query, self.goal, record)
        yield from program.trace(self._placed.address, self._placed.record_bytes)

    @property
    def outputs(self) -> tuple[DeviceArray, ...]:
        return self._placed.copied

    def result(self) -> Any:
        self._placed.finish([self.scope.read(one) for one in self.outputs])
        return self._placed.result

    def store(self, copies: Sequence[NDArray[Any]], sink: Sink, rows: slice) -> None:  # noqa: ARG002
        self._placed.finish(copies)


#: The queries by kind.
QUERIES: Mapping[Kind, type[DeviceQuery]] = MappingProxyType(
    {
        Kind.FIRST_HIT: FirstHit,
        Kind.ANY_HIT: AnyHit,
        Kind.COUNT_HITS: CountHits,
        Kind.MULTI_HIT: MultiHit,
        Kind.TRACE: Trace,
    }
)


def trace_on_device(
    scene: DeviceScene,
    query: Query,
    arrays: RayArrays,
    progress: Progress | None = None,
    payload: Any = None,
) -> Any:
    """Answer a query of rays in device memory, in the caller's stream.

    Parameters
    ----------
    scene : DeviceScene
    query : Query
    arrays : RayArrays
        See `place_device_rays`.
    progress : callable, optional
        Called when kernels have been launched, which the device may not have finished.
    payload : array, dtype or None
        For `Kind.TRACE`: an array on the device is changed in place, a NumPy array is copied
        there and back, a dtype allocates zeros on the device.

    Returns
    -------
    DeviceHits, DeviceArray, DeviceMultiHits, array or None
        On the device, unless the payload is a NumPy array.

    Raises
    ------
    ValueError, TypeError, CudaError
        See `place_device_rays` and `place_payload`; or if the filter or program does not run on
        the device.

    Notes
    -----
    First and any hit and counting return before the device is done. Multi-hit reads the number of
    hits. Worlds and masks on the device are read, too. Filters and programs wait after each round.
    """

    def report(done: int, passes: int) -> None:
        if progress:
            progress(done * len(rays), passes * len(rays))

    kind = scene.triangles.number_type
    world_count = 0 if arrays.worlds is None else scene.triangles.instances.world_count
    with StreamScope(scene.gpu, stream_of(scene.gpu, arrays._asdict())) as scope:
        placed = place_device_rays(scope, arrays, world_count, kind)
        if arrays.mask is not None:
            masks = ray_masks(host_values(scope, "mask", arrays.mask), placed.shape)
            placed = placed.with_masks(scene.masks.place(scope, masks))
        rays = RayLauncher(scene, scope, placed, report=report)
        task = QUERIES[query.kind](query, rays, payload=payload)
        with closing(task.launch()) as steps:  # after an error, before the scope ends
            copies = None
            while (wanted := resume(steps, copies)) is not None:
                copies = [scope.read(one) for one in wanted]
        result = task.result()
    report(task.pass_count, task.pass_count)
    return result
