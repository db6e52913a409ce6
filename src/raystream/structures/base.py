"""Structure: what every acceleration structure offers, and how its kernels are run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress, parallel_for, thread_count
from raystream.kernels.collect import HitArrays
from raystream.kernels.queries import UNLIMITED, LocalRays, RayQueries

__all__ = ["BuildReport", "Structure"]

#: Rays that one call of a compiled loop gets at most: long enough to hide the call's cost
#: (about 20 microseconds), short enough to balance the threads and to notice Ctrl-C.
RAYS_PER_CALL = 4096


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


class Structure(ABC):
    """Triangles arranged for tracing; queries take rays in the triangles' local frame.

    A subclass gives `name`, `queries` (from `kernels.queries.ray_queries`), the `arrays`
    that its traversal reads, `saved_arrays` for a file, and `from_arrays`, which checks what
    comes back from one. Every structure returns the same bits as `Brute`.

    Attributes
    ----------
    name : str
        What `Tracer` calls it.
    triangles : Triangles
    report : BuildReport
    """

    name: ClassVar[str]
    queries: ClassVar[RayQueries]
    triangles: Triangles
    report: BuildReport

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
        self._run(self.queries.count_hits, rays, (rays, surfaces, limit, counts), progress)
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
        self._run(self.queries.multi_hit, rays, (rays, surfaces, splits, out), progress)

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
