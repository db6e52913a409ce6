"""The compute machine: one ray from start to end in each invocation of a compute shader."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, uniform, upload
from raystream.graphics.errors import GraphicsError
from raystream.graphics.forms import form_of
from raystream.graphics.forms.base import numbers
from raystream.graphics.pipelines import bind_group, compute_pipeline
from raystream.graphics.records import (
    ENDLESS,
    RAY_BYTES,
    ROW,
    Query,
    packed_rays,
    unpack_rows,
    without_repeats,
)
from raystream.graphics.source import shader_source
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries

__all__ = ["RAYS_AT_ONCE", "Compute"]

#: Rays that a dispatch gets: a driver may take long ones for hung, and Ctrl-C waits for one.
RAYS_AT_ONCE = 1 << 18

#: Invocations of a workgroup; see compute.wgsl.
_GROUP_SIZE = 64

#: Hits of a ray that can be counted.
_MOST_HITS = 2**32 - 2

#: Rows of hits that one dispatch may write; a ray with more gets a dispatch of its own.
_ROWS_AT_ONCE = 1 << 22


class Compute(BatchQueries):
    """Traces rays with compute shaders.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; its arrays are copied to the device.
    opened : OpenDevice
    rays_at_once : int
        Most rays of a dispatch.

    Raises
    ------
    GraphicsError
        If there are no shaders for the structure, they do not compile, or it is too large for
        the device.
    """

    def __init__(
        self, structure: Structure, opened: OpenDevice, *, rays_at_once: int = RAYS_AT_ONCE
    ) -> None:
        self.structure = structure
        self.opened = opened
        self.rays_at_once = operator.index(rays_at_once)
        if self.rays_at_once < 1:
            raise ValueError(f"rays_at_once: expected at least 1, got {rays_at_once}")
        self._form = form_of(structure)
        self._source = shader_source("compute.wgsl", self._form.shader)
        names = (f"{self._form.name}, array {k}" for k in range(len(self._form.arrays)))
        self._arrays = upload(opened, zip(names, self._form.arrays, strict=True))
        self._buffers = {
            name: Buffer(opened, name) for name in ("rays", "wanted", "rows", "counts", "tallies")
        }
        self._pipeline(Query.FIRST_HIT, False, False)  # whatever is wrong is said now

    @property
    def frame(self) -> SceneFrame:
        """The frame of the structure's triangles."""
        return self.structure.frame

    def first_hit(
        self,
        rays: LocalRays,
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Find the nearest hit of each ray; see `BatchQueries.first_hit`."""
        count = len(rays.t_min)
        for chunk in _chunks(count, self.rays_at_once):
            wanted = np.ones((chunk.stop - chunk.start, 2), np.uint32)
            wanted[:, 0] = np.arange(len(wanted))
            self._run(Query.FIRST_HIT, False, rays, chunk, wanted, len(wanted), tallies)
            unpack_rows(self._rows(len(wanted)), out.part(chunk))
            if progress:
                progress(chunk.stop, count)

    def any_hit(
        self,
        rays: LocalRays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way."""
        return self._count(Query.ANY_HIT, rays, False, 1, progress, tallies) != 0

    def count_hits(
        self,
        rays: LocalRays,
        surfaces: bool,
        limit: int = UNLIMITED,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`."""
        if not self._form.lists_twice or limit <= 1:
            return self._count(Query.COUNT_HITS, rays, surfaces, limit, progress, tallies)
        counts = np.empty(len(rays.t_min), np.int64)
        for chunk, splits, _ in self._distinct(rays, surfaces, tallies):
            counts[chunk] = np.minimum(np.diff(splits), limit)
            if progress:
                progress(chunk.stop, len(counts))
        return counts

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
        count = len(rays.t_min)
        if self._form.lists_twice:
            for chunk, own, rows in self._distinct(rays, surfaces, tallies):
                wanted = splits[chunk.start : chunk.stop + 1]
                unpack_rows(_nearest(rows, own, wanted), out.part(slice(wanted[0], wanted[-1])))
                if progress:
                    progress(chunk.stop, count)
            return
        for chunk in _chunks_of_rows(splits, self.rays_at_once):
            own = splits[chunk.start : chunk.stop + 1]
            rows = self._keep(rays, chunk, surfaces, own - own[0], tallies)
            unpack_rows(rows, out.part(slice(own[0], own[-1])))
            if progress:
                progress(chunk.stop, count)

    def _count(
        self,
        query: Query,
        rays: LocalRays,
        surfaces: bool,
        limit: int,
        progress: Progress | None,
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[np.int64]:
        count = len(rays.t_min)
        counts = np.empty(count, np.int64)
        for chunk in _chunks(count, self.rays_at_once):
            wanted = np.zeros((chunk.stop - chunk.start, 2), np.uint32)
            wanted[:, 1] = min(limit, _MOST_HITS)
            counts[chunk] = self._run(query, surfaces, rays, chunk, wanted, 0, tallies)
            if progress:
                progress(chunk.stop, count)
        return counts

    def _distinct(
        self, rays: LocalRays, surfaces: bool, tallies: NDArray[np.uint32] | None
    ) -> Iterator[tuple[slice, NDArray[np.int64], NDArray[Any]]]:
        """All hits where a search may meet a triangle twice: rays, their splits, and rows."""
        counts = self._count(Query.COUNT_HITS, rays, surfaces, UNLIMITED, None, tallies)
        splits = np.concatenate([[0], np.cumsum(counts)])
        for chunk in _chunks_of_rows(splits, self.rays_at_once):
            own = splits[chunk.start : chunk.stop + 1] - splits[chunk.start]
            rows = self._keep(rays, chunk, surfaces, own, None)
            yield (chunk, *without_repeats(rows, own))

    def _keep(
        self,
        rays: LocalRays,
        chunk: slice,
        surfaces: bool,
        splits: NDArray[np.int64],
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[Any]:
        """Rows of the nearest hits of some rays, of which ray i wants splits[i] to splits[i+1]."""
        wanted = np.column_stack([splits[:-1], np.diff(splits)]).astype(np.uint32)
        self._run(Query.MULTI_HIT, surfaces, rays, chunk, wanted, int(splits[-1]), tallies)
        return self._rows(int(splits[-1]))

    def _rows(self, count: int) -> NDArray[Any]:
        return self._buffers["rows"].read(ROW, (count,))

    def _run(
        self,
        query: Query,
        surfaces: bool,
        rays: LocalRays,
        chunk: slice,
        wanted: NDArray[np.uint32],
        row_count: int,
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[np.uint32]:
        """Trace some rays; returns how many hits each has."""
        count = len(wanted)
        buffers = self._buffers
        for name, byte_count in (
            ("rays", RAY_BYTES * count),
            ("wanted", wanted.nbytes),
            ("rows", ROW.itemsize * row_count),
            ("counts", 4 * count),
            ("tallies", 0 if tallies is None else 32 * count),
        ):
            buffers[name].reserve(byte_count)
        buffers["rays"].write(packed_rays(rays, chunk))
        buffers["wanted"].write(wanted)
        self._dispatch(self._pipeline(query, surfaces, tallies is not None), count)
        counts = buffers["counts"].read(np.uint32, (count,))
        if (counts == ENDLESS).any():
            raise GraphicsError(
                f"device 'graphics': the search of {int((counts == ENDLESS).sum()):,} rays in "
                f"{self._form.name!r} took more than {self._form.budget:,} steps and tests"
            )
        if tallies is not None:
            tallies[chunk] += buffers["tallies"].read(np.uint32, (count, 8))
        return counts

    def _dispatch(self, pipeline: Any, count: int) -> None:
        groups = -(-count // _GROUP_SIZE)
        most = self.opened.limits["max-compute-workgroups-per-dimension"]
        columns = min(groups, most)
        params = numbers(
            self.structure.triangles.extreme, 0, count, columns * _GROUP_SIZE, self._form.budget
        )
        params += bytes(32 - len(params)) + self._form.tree
        shared = [self._buffers[name].binding for name in self._buffers]
        content = {"buffer": (buffer := uniform(self.opened, params)), "size": buffer.size}
        device = self.opened.device
        encoder = device.create_command_encoder()
        run = encoder.begin_compute_pass()
        run.set_pipeline(pipeline)
        run.set_bind_group(0, bind_group(self.opened, pipeline, 0, [content, *shared]))
        own = [buffer.binding for buffer in self._arrays]
        run.set_bind_group(1, bind_group(self.opened, pipeline, 1, own))
        run.dispatch_workgroups(columns, -(-groups // columns))
        run.end()
        device.queue.submit([encoder.finish()])

    def _pipeline(self, query: Query, surfaces: bool, counts: bool) -> Any:
        constants = {
            "QUERY": float(query),
            "SURFACES": float(surfaces),
            "COUNTS": float(counts),
            **self._form.constants,
        }
        name = f"{self._form.name}, {query.name}"
        return compute_pipeline(self.opened, self._source, name, constants)


def _chunks(count: int, size: int) -> Iterator[slice]:
    for begin in range(0, count, size):
        yield slice(begin, min(begin + size, count))


def _chunks_of_rows(splits: NDArray[np.int64], size: int) -> Iterator[slice]:
    """Rays that together have so many rows at most; or one that alone has more."""
    begin, count = 0, len(splits) - 1
    while begin < count:
        end = int(np.searchsorted(splits, splits[begin] + _ROWS_AT_ONCE, "right")) - 1
        end = min(max(end, begin + 1), begin + size, count)
        yield slice(begin, end)
        begin = end


def _nearest(
    rows: NDArray[Any], splits: NDArray[np.int64], wanted: NDArray[np.int64]
) -> NDArray[Any]:
    """Of each ray's rows the first ones: as many as its part of `wanted` is long."""
    counts = np.diff(wanted)
    ends = np.cumsum(counts)
    within = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)
    return rows[np.repeat(splits[:-1], counts) + within]
