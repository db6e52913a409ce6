"""Structure: what every acceleration structure offers, and how its kernels are run."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays, RayQueries
from raystream.structures.batches import BatchQueries
from raystream.structures.found import Collected, Found, FoundVisitor, allocate_hits
from raystream.structures.gathering import Gatherer
from raystream.structures.ray_block import RayBlock, blocks

__all__ = ["BuildReport", "Structure", "UpdateReport"]

#: Rays that one call of a compiled loop gets at most: long enough to hide the call's cost
#: (about 20 microseconds), short enough to balance the threads and to notice Ctrl-C.
RAYS_PER_CALL = 4096

#: Hits for which there is room at first: it stays in the cache.
FIRST_CAPACITY = 1 << 14


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


class HitRows(NamedTuple):
    """Buffers for `RayQueries.gather`."""

    hits: HitArrays
    capacity: int

    @classmethod
    def of(cls, capacity: int) -> HitRows:
        """Room for so many hits."""
        return cls(allocate_hits(capacity), capacity)


class Structure(BatchQueries):
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
        """What the traversal is given: numbers, and addresses of arrays."""

    @property
    @abstractmethod
    def memory(self) -> dict[str, NDArray[Any]]:
        """The arrays at these addresses, by the names that they have in `arrays`.

        Where one is empty, the address may be 0; kernels are then never told to read it.
        """

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

    def first_hit(
        self,
        rays: LocalRays,
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Find the nearest hit of each ray; see `BatchQueries.first_hit`."""
        self._run(self.queries.first_hit, rays, (rays, out, tallies), progress)

    def any_hit(
        self,
        rays: LocalRays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; see `BatchQueries.any_hit`."""
        seen = np.empty(len(rays.t_min), np.bool_)
        self._run(self.queries.any_hit, rays, (rays, seen, tallies), progress)
        return seen

    def count_hits(
        self,
        rays: LocalRays,
        surfaces: bool,
        limit: int = UNLIMITED,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`; see `BatchQueries.count_hits`."""
        counts = np.empty(len(rays.t_min), np.int64)
        arguments = rays, self.lists_twice, surfaces, limit, counts, tallies
        self._run(self.queries.count_hits, rays, arguments, progress)
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
        arguments = rays, self.lists_twice, surfaces, splits, out, tallies
        self._run(self.queries.multi_hit, rays, arguments, progress)

    def multi_hit_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> tuple[NDArray[np.int64], HitArrays]:
        """Find the nearest hits of each ray; see `BatchQueries.multi_hit_batch`.

        Notes
        -----
        Without tallies there is one search, in buffers that grow, and for a while the hits
        take twice their memory.
        """
        if tallies is not None or limit == 0:
            return super().multi_hit_batch(batch, surfaces, limit, status, progress, tallies)
        collected = Collected(len(batch))
        self.visit_hits_batch(batch, surfaces, limit, True, collected.take, status, progress)
        return collected.whole()

    def visit_hits_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        is_ordered: bool,
        visitor: FoundVisitor,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> None:
        """Give the nearest hits of each ray to a function; see `BatchQueries`."""
        for block in blocks(batch, self.frame, status, progress):
            self._visit_block(block, surfaces, limit, is_ordered, visitor)

    def _visit_block(
        self, block: RayBlock, surfaces: bool, limit: int, is_ordered: bool, visitor: FoundVisitor
    ) -> None:
        gather, rays, first = self.queries.gather, block.rays, block.rows.start
        arguments = self.arrays, self.triangles.extreme, rays, block.t_scale
        goal = self.lists_twice, surfaces, limit, is_ordered

        def fill(begin: int, end: int, rows: HitRows) -> int:
            splits = np.empty(end - begin + 1, np.int64)
            reached = int(gather(begin, end, *arguments, *goal, splits, rows.hits))
            if reached > begin:
                visitor(Found(rows.hits, splits[: reached - begin + 1], None, first + begin))
            return reached

        count = len(rays.t_min)
        body = Gatherer(HitRows.of, fill, FIRST_CAPACITY)
        parallel_for(body, count, self._chunk(count), block.progress)

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
        parallel_for(body, count, self._chunk(count), progress)

    def _chunk(self, count: int) -> int:
        """Rays that a call gets."""
        # A batch is split among the threads even when it is smaller than a call could take,
        # but not so far that the hand-over costs more than the rays.
        share = max(256, -(-count // (4 * thread_count())))
        return min(self.rays_per_call(), share)
