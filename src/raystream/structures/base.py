"""Structure: what every acceleration structure offers."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

from numpy.typing import NDArray

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.queries import RayQueries, ray_queries
from raystream.kernels.ray import SceneFrame
from raystream.kernels.sink import Sink
from raystream.structures.registry import StructureOptions

__all__ = ["BuildReport", "Structure", "UpdateReport"]

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


class Structure(ABC):
    """Triangles arranged for tracing.

    A subclass gives its `traverse` (see `kernels.queries.ray_queries`) and the `stack_bytes` that
    it needs, the `arrays` that the traversal reads, `saved_arrays` for a file, and `from_arrays`,
    which checks what comes back from one. Every structure returns the same bits as brute force.

    Attributes
    ----------
    can_have_duplicates : bool
        Whether `has_duplicates` may be true of one; of the class.
    triangles : Triangles
    report : BuildReport
    options : StructureOptions
        How it was built and is traced.
    """

    traverse: ClassVar[Callable[..., Any]]
    stack_bytes: ClassVar[int] = 8
    can_have_duplicates: ClassVar[bool] = False
    queries: ClassVar[RayQueries]
    triangles: Triangles
    report: BuildReport
    options: StructureOptions

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "traverse" in cls.__dict__:
            cls.queries = ray_queries(
                cls.traverse, cls.stack_bytes, has_duplicates=cls.can_have_duplicates
            )

    @abstractmethod
    def __init__(
        self, triangles: Triangles, options: Any, *, progress: Progress | None = None
    ) -> None:
        """Build it."""

    @property
    def name(self) -> str:
        """What `Tracer` calls it."""
        return self.options.name

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
    def from_arrays(
        cls, triangles: Triangles, arrays: Mapping[str, NDArray[Any]], options: Any
    ) -> Structure:
        """Make a structure of arrays that were saved, and its options.

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
    def has_duplicates(self) -> bool:
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
        structure = type(self)(triangles, self.options, progress=progress)
        seconds = time.perf_counter() - started
        return structure, UpdateReport(True, seconds, math.nan, math.nan)

    def trace_batch(
        self,
        query: Query,
        rays: RayBatch,
        sink: Sink,
        progress: Progress | None = None,
    ) -> bool:
        """Answer a query with kernels that trace many rays at a time, where they suit it.

        Parameters
        ----------
        query : Query
            Without filter or counters.
        rays : RayBatch
        sink : Sink
            Of `Kind.MULTI_HIT` with a visitor.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        bool
            False if it did nothing: the machine traces the rays one by one.
        """
        return False
