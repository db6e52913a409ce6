"""The four queries of the graphics device's machines, around one that traces some rays."""

from __future__ import annotations

import operator
import time
from abc import abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.forms import Form, form_of
from raystream.graphics.guarding import guard_queries
from raystream.graphics.pace import Pace
from raystream.graphics.records import MOST_HITS, Query, unpack_rows, without_repeats
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries

__all__ = ["RAYS_AT_ONCE", "GraphicsQueries"]

#: Most rays that a dispatch or a draw gets; see `pace` for how many it should get.
RAYS_AT_ONCE = 1 << 18

#: Rows of hits that may be written at once; a ray with more is traced by itself.
_ROWS_AT_ONCE = 1 << 22


@guard_queries
class GraphicsQueries(BatchQueries):
    """The four queries, for a machine that traces some rays at a time.

    Parameters
    ----------
    structure : Structure
        Built on the CPU.
    opened : OpenDevice
    rays_at_once : int
        Most rays that are traced together.

    Attributes
    ----------
    is_paced : bool
        Whether fewer rays are traced together where they take long.

    Raises
    ------
    GraphicsError
        If there are no shaders for the structure.
    """

    is_paced: ClassVar[bool] = False

    def __init__(self, structure: Structure, opened: OpenDevice, rays_at_once: int) -> None:
        self.structure = structure
        self.opened = opened
        self.rays_at_once = operator.index(rays_at_once)
        if self.rays_at_once < 1:
            raise ValueError(f"rays_at_once: expected at least 1, got {rays_at_once}")
        self._form: Form = form_of(structure)
        self._paces: dict[Query, Pace] = {}

    @abstractmethod
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
        """Trace some rays; returns how many hits each has.

        Parameters
        ----------
        query : Query
        surfaces : bool
        rays : LocalRays
        chunk : slice
            Which of them.
        wanted : ndarray of shape (N, 2), uint32
            Of each of these the first of its rows, and how many hits are wanted.
        row_count : int
            Rows of all of them, which `_rows` gives afterwards.
        tallies : ndarray of shape (M, 8), uint32, or None
            What each of all rays meets is added to its row.
        """

    @abstractmethod
    def _rows(self, count: int) -> NDArray[Any]:
        """What the latest `_run` has found: `records.ROW` of each row."""

    def _asked(
        self,
        query: Query,
        surfaces: bool,
        rays: LocalRays,
        chunk: slice,
        wanted: NDArray[np.uint32],
        row_count: int,
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[np.uint32]:
        """As `_run`, noting how long it takes."""
        began = time.perf_counter()
        counts = self._run(query, surfaces, rays, chunk, wanted, row_count, tallies)
        self._pace(query).took(len(wanted), time.perf_counter() - began)
        return counts

    def _pace(self, query: Query) -> Pace:
        return self._paces.setdefault(query, Pace(self.rays_at_once))

    def _chunks(
        self, query: Query, count: int, splits: NDArray[np.int64] | None = None
    ) -> Iterator[slice]:
        """Rays that are traced together; or one ray that alone has too many rows."""
        begin = 0
        while begin < count:
            size = self._pace(query).size if self.is_paced else self.rays_at_once
            end = min(begin + size, count)
            if splits is not None:
                fits = int(np.searchsorted(splits, splits[begin] + _ROWS_AT_ONCE, "right")) - 1
                end = min(end, max(fits, begin + 1))
            yield slice(begin, end)
            begin = end

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
        for chunk in self._chunks(Query.FIRST_HIT, count):
            wanted = np.ones((chunk.stop - chunk.start, 2), np.uint32)
            wanted[:, 0] = np.arange(len(wanted))
            self._asked(Query.FIRST_HIT, False, rays, chunk, wanted, len(wanted), tallies)
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
        for chunk in self._chunks(Query.MULTI_HIT, len(splits) - 1, splits):
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
        for chunk in self._chunks(query, count):
            wanted = np.zeros((chunk.stop - chunk.start, 2), np.uint32)
            wanted[:, 1] = min(limit, MOST_HITS)
            counts[chunk] = self._asked(query, surfaces, rays, chunk, wanted, 0, tallies)
            if progress:
                progress(chunk.stop, count)
        return counts

    def _distinct(
        self, rays: LocalRays, surfaces: bool, tallies: NDArray[np.uint32] | None
    ) -> Iterator[tuple[slice, NDArray[np.int64], NDArray[Any]]]:
        """All hits where a search may meet a triangle twice: rays, their splits, and rows."""
        counts = self._count(Query.COUNT_HITS, rays, surfaces, UNLIMITED, None, tallies)
        splits = np.concatenate([[0], np.cumsum(counts)])
        for chunk in self._chunks(Query.MULTI_HIT, len(splits) - 1, splits):
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
        self._asked(Query.MULTI_HIT, surfaces, rays, chunk, wanted, int(splits[-1]), tallies)
        return self._rows(int(splits[-1]))


def _nearest(
    rows: NDArray[Any], splits: NDArray[np.int64], wanted: NDArray[np.int64]
) -> NDArray[Any]:
    """Of each ray's rows the first ones: as many as its part of `wanted` is long."""
    counts = np.diff(wanted)
    ends = np.cumsum(counts)
    within = np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)
    return rows[np.repeat(splits[:-1], counts) + within]
