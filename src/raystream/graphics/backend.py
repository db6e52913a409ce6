"""GraphicsBackend: queries on the graphics device, in chunks of rays."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_least
from raystream.core.query import Kind, Query
from raystream.graphics.adapters import OpenDevice
from raystream.graphics.dispatch_size import DispatchSize
from raystream.graphics.error_scope import guarded
from raystream.graphics.packing import MOST_HITS, unpack_rows
from raystream.graphics.structures import ShaderStructure, shader_structure_of
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.kernels.local_frame import LocalRays
from raystream.machines.local_frame_backend import LocalFrameBackend
from raystream.structures import Structure

#: Most rays of a dispatch or a draw; see `dispatch_size` for how many it should have.
RAYS_AT_ONCE = 1 << 18

#: Most hits that a chunk may keep; a ray with more is traced by itself.
_ROWS_AT_ONCE = 1 << 22


class Chunk(NamedTuple):
    """Rays that are traced together, and the hits wanted of them.

    Attributes
    ----------
    kind : Kind
    surfaces : bool
    rays : LocalRays
        All rays of the query.
    rows : slice
        Which of them.
    wanted : ndarray of shape (n, 2), uint32
        First row and capacity of each of them.
    row_count : int
        Rows of all of them, which `_rows` returns afterwards; 0 if hits are only counted.
    tallies : ndarray of shape (N, 8), uint32, or None
        Counters of all rays, which are added to.
    """

    kind: Kind
    surfaces: bool
    rays: LocalRays
    rows: slice
    wanted: NDArray[np.uint32]
    row_count: int
    tallies: NDArray[np.uint32] | None


class GraphicsBackend(LocalFrameBackend):
    """Queries of local rays, for machines that trace them in chunks.

    Parameters
    ----------
    structure : Structure
        Built on the CPU.
    opened : OpenDevice
    rays_at_once : int
        Most rays of a chunk.

    Attributes
    ----------
    adapts_size : bool
        Whether slow rays are traced in smaller chunks.

    Raises
    ------
    GraphicsError
        If there are no shaders for the structure.
    """

    adapts_size: ClassVar[bool] = False

    def __init__(self, structure: Structure, opened: OpenDevice, rays_at_once: int) -> None:
        self.structure = structure
        self.opened = opened
        self.rays_at_once = check_least("rays_at_once", rays_at_once, 1)
        self._shaders: ShaderStructure = shader_structure_of(structure)
        self._sizes: dict[Kind, DispatchSize] = {}

    @abstractmethod
    def _run(self, chunk: Chunk) -> NDArray[np.uint32]:
        """Trace a chunk; returns the number of hits of each ray."""

    @abstractmethod
    def _rows(self, count: int) -> NDArray[Any]:
        """The rows of `packing.ROW` that the latest `_run` kept."""

    def run_local(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Answer a query of local rays; see `LocalFrameBackend.run_local`."""
        answers = {
            Kind.FIRST_HIT: self._first_hit,
            Kind.ANY_HIT: self._any_hit,
            Kind.MULTI_HIT: self._multi_hit,
        }
        with guarded(self.opened):
            answers.get(query.kind, self._count_hits)(query, rays, sink, progress)

    def _first_hit(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None
    ) -> None:
        count, kind, hits = len(rays.t_min), query.kind, sink.hits
        for rows in self._chunks(kind, count):
            wanted = np.ones((rows.stop - rows.start, 2), np.uint32)
            wanted[:, 0] = np.arange(len(wanted))
            self._timed(Chunk(kind, False, rays, rows, wanted, len(wanted), sink.tallies))
            unpack_rows(self._rows(len(wanted)), hits.part(rows))
            if progress:
                progress(rows.stop, count)

    def _any_hit(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None
    ) -> None:
        seen = self._count(query._replace(limit=1), rays, sink.tallies, progress)
        np.not_equal(seen, 0, out=sink.seen)

    def _count_hits(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None
    ) -> None:
        sink.counts[:] = self._count(query, rays, sink.tallies, progress)

    def _multi_hit(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None
    ) -> None:
        count, splits, hits = len(rays.t_min), sink.splits, sink.hits
        for rows in self._chunks(Kind.MULTI_HIT, len(splits) - 1, splits):
            own = splits[rows.start : rows.stop + 1]
            found = self._keep(rays, rows, query.surfaces, own - own[0], sink.tallies)
            unpack_rows(found, hits.part(slice(own[0], own[-1])))
            if progress:
                progress(rows.stop, count)

    def _count(
        self,
        query: Query,
        rays: LocalRays,
        tallies: NDArray[np.uint32] | None,
        progress: Progress | None,
    ) -> NDArray[np.int64]:
        count = len(rays.t_min)
        counts = np.empty(count, np.int64)
        for rows in self._chunks(query.kind, count):
            wanted = np.zeros((rows.stop - rows.start, 2), np.uint32)
            wanted[:, 1] = min(query.limit, MOST_HITS)
            chunk = Chunk(query.kind, query.surfaces, rays, rows, wanted, 0, tallies)
            counts[rows] = self._timed(chunk)
            if progress:
                progress(rows.stop, count)
        return counts

    def _keep(
        self,
        rays: LocalRays,
        rows: slice,
        surfaces: bool,
        splits: NDArray[np.int64],
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[Any]:
        """Rows of the nearest hits of some rays: those of ray i are splits[i] to splits[i+1]."""
        wanted = np.column_stack([splits[:-1], np.diff(splits)]).astype(np.uint32)
        row_count = int(splits[-1])
        self._timed(Chunk(Kind.MULTI_HIT, surfaces, rays, rows, wanted, row_count, tallies))
        return self._rows(row_count)

    def _timed(self, chunk: Chunk) -> NDArray[np.uint32]:
        """As `_run`; its time sets the size of later chunks."""
        began = time.perf_counter()
        counts = self._run(chunk)
        self._size_for(chunk.kind).took(len(chunk.wanted), time.perf_counter() - began)
        return counts

    def _size_for(self, kind: Kind) -> DispatchSize:
        return self._sizes.setdefault(kind, DispatchSize(self.rays_at_once))

    def _chunks(
        self, kind: Kind, count: int, splits: NDArray[np.int64] | None = None
    ) -> Iterator[slice]:
        """Ranges of rays to trace together; a ray with too many rows is a range of its own."""
        begin = 0
        while begin < count:
            size = self._size_for(kind).size if self.adapts_size else self.rays_at_once
            end = min(begin + size, count)
            if splits is not None:
                fits = int(np.searchsorted(splits, splits[begin] + _ROWS_AT_ONCE, "right")) - 1
                end = min(end, max(fits, begin + 1))
            yield slice(begin, end)
            begin = end
