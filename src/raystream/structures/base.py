"""Structure: what every acceleration structure offers, and how its kernels are run."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for, part_of, thread_count
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays, RayQueries
from raystream.structures.ray_block import blocks

__all__ = ["BuildReport", "Structure", "UpdateReport", "allocate_hits"]

#: Rays that one call of a compiled loop gets at most: long enough to hide the call's cost
#: (about 20 microseconds), short enough to balance the threads and to notice Ctrl-C.
RAYS_PER_CALL = 4096

#: Hits for which it is worth asking the system whether it has the memory, which takes longer
#: than a small query.
CHECKED_HITS = 1 << 20


@dataclass(frozen=True)
class BuildReport:
    """Figures about a built structure.

    Attributes
    ----------
    seconds : float
        Wall-clock time of the build.
    byte_count : int
        Memory of the structure's arrays.
    """

    seconds: float
    byte_count: int


@dataclass(frozen=True)
class UpdateReport:
    """What `Tracer.update` did.

    Attributes
    ----------
    rebuilt : bool
        Whether the structure was built anew, else it was adjusted.
    seconds : float
        Wall-clock time.
    cost : float
        Cost of tracing the structure as it is now, by the surface area heuristic: the
        expected price of a random ray that meets the scene's bounds. nan for structures
        that do not say.
    cost_when_built : float
        The same when it was last built.
    """

    rebuilt: bool
    seconds: float
    cost: float
    cost_when_built: float


def allocate_hits(count: int) -> HitArrays:
    """Make room for the hits of `multi_hit`; raises MemoryError if there is not so much."""
    if count >= CHECKED_HITS:
        remedy = "give max_hits, or fewer rays at a time"
        check_memory(count * 16, f"multi_hit: {count:,} hits would", remedy)
    return HitArrays.empty(count)


class Structure(ABC):
    """Triangles arranged for tracing.

    A subclass gives `name`, `queries` (from `kernels.queries.ray_queries`), the `arrays`
    that its traversal reads, `saved_arrays` for a file, and `from_arrays`, which checks what
    comes back from one. Every structure returns the same bits as `Brute`.

    Attributes
    ----------
    name : str
        What `Tracer` calls it.
    triangles : Triangles
    report : BuildReport
    options : dict
        Build options, to build it again.
    """

    name: ClassVar[str]
    queries: ClassVar[RayQueries]
    triangles: Triangles
    report: BuildReport
    options: Mapping[str, Any] = MappingProxyType({})

    @abstractmethod
    def __init__(
        self, triangles: Triangles, *, progress: Progress | None = None, **options: Any
    ) -> None:
        """Build it."""

    @property
    @abstractmethod
    def arrays(self) -> NamedTuple:
        """The arrays that the traversal reads."""

    @abstractmethod
    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """What a file must hold, besides the triangles, so that nothing is built again."""

    @classmethod
    @abstractmethod
    def from_arrays(cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]]) -> Structure:
        """Make a structure of arrays that were saved.

        Raises
        ------
        ValueError
            If an array is missing, or its shape, dtype or content could make a traversal
            read out of bounds or not end.
        """

    def quality(self) -> dict[str, float]:
        """The structure's own figures, such as node counts and expected traversal cost."""
        return {}

    def rays_per_call(self) -> int:
        """Most rays that one call of a compiled loop gets."""
        return RAYS_PER_CALL

    @cached_property
    def frame(self) -> SceneFrame:
        """The triangles' local frame, as kernels take it."""
        return SceneFrame.of(self.triangles)

    @property
    def lists_twice(self) -> bool:
        """Whether its traversal may meet a triangle more than once."""
        return False

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Make the structure of moved triangles; this one is not to be used any more.

        Parameters
        ----------
        triangles : Triangles
            As many as before, in the same local frame.
        max_cost_growth : float
            A structure that can be adjusted is built anew if that made it more than so many
            times as expensive to trace.
        progress : callable, optional
            Called with (triangles placed, triangles) if it is built anew.

        Returns
        -------
        structure : Structure
        report : UpdateReport
        """
        started = time.perf_counter()
        structure = type(self)(triangles, progress=progress, **self.options)
        seconds = time.perf_counter() - started
        return structure, UpdateReport(True, seconds, math.nan, math.nan)

    # ---- Whole batches, in world space: what a tracer asks. A structure that does better than
    # the blocks of local rays below overrides these.

    def first_hit_batch(
        self, batch: RayBatch, status: NDArray[np.uint8], progress: Progress | None = None
    ) -> HitArrays:
        """Find the nearest hit of each ray; a miss has t = inf and prim_id = -1.

        Parameters
        ----------
        batch : RayBatch
        status : ndarray of shape (N,), uint8
            A `RayStatus` for each ray: VALID on entry, changed for invalid ones.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        HitArrays
            Row i is of ray i, with t in world direction lengths.
        """
        out = HitArrays.empty(len(batch))
        for block in blocks(batch, self.frame, status, progress):
            part = out.part(block.rows)
            self.first_hit(block.rays, part, block.progress)
            block.to_world(part.t, np.arange(len(part.t) + 1))
        return out

    def any_hit_batch(
        self, batch: RayBatch, status: NDArray[np.uint8], progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; returns shape (N,), bool."""
        seen = np.empty(len(batch), np.bool_)
        for block in blocks(batch, self.frame, status, progress):
            seen[block.rows] = self.any_hit(block.rays, block.progress)
        return seen

    def count_hits_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`; returns shape (N,), int64."""
        counts = np.empty(len(batch), np.int64)
        for block in blocks(batch, self.frame, status, progress):
            counts[block.rows] = self.count_hits(block.rays, surfaces, limit, block.progress)
        return counts

    def multi_hit_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> tuple[NDArray[np.int64], HitArrays]:
        """Find the nearest `limit` hits of each ray, by t, then prim_id.

        Returns
        -------
        splits : ndarray of shape (N + 1,), int64
            Ray i owns rows splits[i] to splits[i + 1].
        hits : HitArrays
            With t in world direction lengths.

        Raises
        ------
        MemoryError
            If the hits need more memory than there is.
        """
        splits = np.zeros(len(batch) + 1, np.int64)
        if limit:
            first_half = part_of(progress, 0, 2 * len(batch))
            counts = self.count_hits_batch(batch, surfaces, limit, status, first_half)
            np.cumsum(counts, out=splits[1:])
        hits = allocate_hits(int(splits[-1]))
        second_half = part_of(progress, len(batch), 2 * len(batch))
        for block in blocks(batch, self.frame, status, second_half):
            rows = splits[block.rows.start : block.rows.stop + 1]
            self.multi_hit(block.rays, surfaces, rows, hits, block.progress)
            block.to_world(hits.t, rows)
        return splits, hits

    # ---- Local rays.

    def first_hit(self, rays: LocalRays, out: HitArrays, progress: Progress | None = None) -> None:
        """Find the nearest hit of each ray; a miss has t = inf and prim_id = -1.

        Parameters
        ----------
        rays : LocalRays
        out : HitArrays
            Row i is written for ray i.
        progress : callable, optional
            Called with (rays done, rays to do).
        """
        self._run(self.queries.first_hit, rays, (rays, out), progress)

    def any_hit(self, rays: LocalRays, progress: Progress | None = None) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way."""
        seen = np.empty(len(rays.t_min), np.bool_)
        self._run(self.queries.any_hit, rays, (rays, seen), progress)
        return seen

    def count_hits(
        self,
        rays: LocalRays,
        surfaces: bool,
        limit: int = UNLIMITED,
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`."""
        counts = np.empty(len(rays.t_min), np.int64)
        arguments = rays, self.lists_twice, surfaces, limit, counts
        self._run(self.queries.count_hits, rays, arguments, progress)
        return counts

    def multi_hit(
        self,
        rays: LocalRays,
        surfaces: bool,
        splits: NDArray[np.int64],
        out: HitArrays,
        progress: Progress | None = None,
    ) -> None:
        """Write the nearest splits[i + 1] - splits[i] hits of each ray i, by t, then prim_id.

        Parameters
        ----------
        rays : LocalRays
        surfaces : bool
        splits : ndarray of shape (N + 1,), int64
            From the counts of `count_hits`: no ray may have room for more hits than it has.
        out : HitArrays
            Rows splits[0] to splits[N] are written.
        """
        arguments = rays, self.lists_twice, surfaces, splits, out
        self._run(self.queries.multi_hit, rays, arguments, progress)

    def _run(
        self,
        query: Callable[..., None],
        rays: LocalRays,
        arguments: tuple[Any, ...],
        progress: Progress | None,
    ) -> None:
        arrays, extreme = self.arrays, self.triangles.extreme

        def body(begin: int, end: int) -> None:
            query(begin, end, arrays, extreme, *arguments)

        count = len(rays.t_min)
        # A batch is split among the threads even when it is smaller than a call could take,
        # but not so far that the hand-over costs more than the rays.
        share = max(256, -(-count // (4 * thread_count())))
        parallel_for(body, count, min(self.rays_per_call(), share), progress)
