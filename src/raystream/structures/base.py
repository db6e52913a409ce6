"""Structure: the base class of acceleration structures."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.kernels.queries import RayQueries, RaySearches, ray_queries, searches
from raystream.kernels.ray import SceneFrame
from raystream.structures.batch_kernels import BatchKernels, Calls
from raystream.structures.registry import StructureOptions, form_of
from raystream.structures.single_kernels import RAYS_PER_CALL, with_single

#: Triangle tests per call: about 50 ms, or 0.2 s at worst in a grid. (With a quarter of it, calls
#: of 52 rays took a tenth of the time in a hall with a few very long lists.)
_TESTS_PER_CALL = 1 << 23


@dataclass(frozen=True)
class BuildReport:
    """Build time and memory of a structure.

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
    """The result of `Tracer.update`.

    Attributes
    ----------
    rebuilt : bool
        Whether the structure was rebuilt rather than adjusted.
    seconds : float
        Wall-clock time.
    cost : float
        Current cost of tracing by the surface area heuristic: the expected cost of a random
        ray that hits the scene's bounds. nan for structures without one.
    cost_when_built : float
        The same right after the last build.
    """

    rebuilt: bool
    seconds: float
    cost: float
    cost_when_built: float


class Nested(NamedTuple):
    """Addresses in a structure's arrays, for copies of it elsewhere.

    Attributes
    ----------
    arrays : tuple of ndarray
        Arrays besides those of `Structure.arrays`, which never change.
    fields : mapping of str to tuple of str
        By name of arrays: their fields that are addresses in one of all these arrays,
        or 0.
    names : tuple of str
        Such fields of `Structure.view`, besides the names of its arrays.
    """

    arrays: tuple[NDArray[Any], ...] = ()
    fields: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    names: tuple[str, ...] = ()


class Structure(ABC):
    """Triangles arranged for tracing.

    A subclass provides `traverse` (see `kernels.queries.ray_queries`) and the `stack_bytes` that
    it needs, and the `view` that the traversal reads. One that takes long to build also has
    `saved_arrays` for a file, and `from_arrays`, which validates arrays from a file. Every
    structure returns the same bits as brute force.

    Attributes
    ----------
    triangles : Triangles
    report : BuildReport
    options : StructureOptions
        Build and traversal options.
    view : NamedTuple
        What the traversal reads: numbers, and addresses of arrays.
    arrays : dict of str to ndarray
        The arrays at these addresses, by field name of `view`; and others of `nested`. The address
        of an empty one may be 0; kernels never read it.
    make_searches : callable
        Makes the searches of a ray with `traverse`; see `kernels.queries.searches`.
    queries : RayQueries
        The queries of single rays.
    ray_batch : type of RayBatch
        What rays are made into.
    least_rays : int
        Least rays per call of the queries of single rays.
    precision : {"float32", "float64"}
        Precision of triangles and distances.
    many_ray_kernels : mapping of Kind to BatchKernels
        The kernels that trace many rays of a query at a time, if there are any.
    is_outdated : bool
        Whether `updated` has moved its arrays, which another structure has now.
    """

    traverse: ClassVar[Callable[..., Any]]
    stack_bytes: ClassVar[int] = 8
    make_searches: ClassVar[Callable[..., RaySearches]] = staticmethod(searches)
    queries: ClassVar[RayQueries]
    ray_batch: ClassVar[type[RayBatch]] = RayBatch
    least_rays: ClassVar[int] = 256
    precision: ClassVar[str] = "float32"
    many_ray_kernels: Mapping[Kind, BatchKernels] = MappingProxyType({})
    is_outdated: bool = False
    triangles: Triangles
    report: BuildReport
    options: StructureOptions
    view: Any
    arrays: dict[str, NDArray[Any]]

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "traverse" in cls.__dict__:
            cls.queries = ray_queries(cls.traverse, cls.stack_bytes, cls.make_searches)

    @abstractmethod
    def __init__(
        self, triangles: Triangles, options: Any, *, progress: Progress | None = None
    ) -> None:
        """Build it."""

    @property
    def name(self) -> str:
        """Its name in `Tracer`."""
        return self.options.name

    @property
    def on_host(self) -> Structure:
        """Itself; of a structure that is on a device, its copy in host memory."""
        return self

    def view_for(
        self,
        query: Query,
        rays: RayBatch,
        sink: Sink,
    ) -> NamedTuple:
        """The view for a query that the branching machine answers ray by ray."""
        return self.view

    @property
    def point_loop(self) -> Callable[..., None] | None:
        """Its loop over points, see `kernels.point_queries.nearest_answer`; None without one."""
        found: Callable[..., None] | None = form_of(self.name, "nearest")
        return found

    @property
    def point_view(self) -> Any:
        """What that loop reads as `view`."""
        return self.view

    def around_calls(
        self,
        points: NDArray[np.float64],
        numbers: NDArray[np.float64],
    ) -> Calls | None:
        """The calls that add what is not triangles to winding numbers of world points, if any."""
        return None

    def raise_faults(self) -> None:
        """Raise what went wrong in users' functions that its geometry has, see `Shape`."""
        return

    def checked(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """A function of kernels, or one that also does `raise_faults`."""
        return function

    @property
    def nested(self) -> Nested:
        """The addresses that are in the arrays, and the arrays there."""
        return Nested()

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays to save besides the triangles, so that loading builds nothing [default: none].

        Copies and pickles have what a file holds.
        """
        return {}

    @classmethod
    def from_arrays(
        cls,
        triangles: Triangles,
        arrays: Mapping[str, NDArray[Any]],
        options: Any,
    ) -> Structure:
        """Make a structure from saved arrays and options [default: build it].

        Raises
        ------
        ValueError
            If an array is missing, or its shape, dtype or content could make a traversal
            read out of bounds or never end.
        """
        return cls(triangles, options)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle what a file holds: addresses are those of the copy's own arrays."""
        return _restored, (type(self), self.triangles, self.saved_arrays(), self.options)

    def quality(self) -> dict[str, float]:
        """Figures such as node counts and the expected traversal cost."""
        return {}

    @property
    def sector_count(self) -> int | None:
        """The number of sectors that hits can name; None if they name none."""
        return None

    @cached_property
    def kernel_times(self) -> dict[Hashable, Any]:
        """Times of these kernels by kind of batch; see `machines.race`."""
        return {}

    @cached_property
    def batch_kernels(self) -> Mapping[Kind, BatchKernels]:
        """All kernels by the kind of query: for many rays, and for single ones."""
        return with_single(self)

    @cached_property
    def rays_per_call(self) -> int:
        """Most rays per call of a compiled loop: fewer where they are slow, to keep calls short."""
        return max(1, min(RAYS_PER_CALL, _TESTS_PER_CALL // max(1, self.tests_per_ray)))

    @property
    def tests_per_ray(self) -> int:
        """About the most triangles that a ray is tested against, if they make it slow."""
        return 1

    @cached_property
    def frame(self) -> SceneFrame:
        """The triangles' local frame, as passed to kernels."""
        return SceneFrame.of(self.triangles)

    @cached_property
    def tracers(self) -> WeakValueDictionary[int, Any]:
        """The tracers of this structure, by their `id`."""
        return WeakValueDictionary()

    def updated(
        self, triangles: Triangles, max_cost_growth: float, progress: Progress | None = None
    ) -> tuple[Structure, UpdateReport]:
        """Make the structure of moved triangles.

        This one must not be used afterwards, unless it has several `tracers`: then its arrays stay
        as they are.

        Parameters
        ----------
        triangles : Triangles
            The same number, in any local frame.
        max_cost_growth : float
            A structure that can be adjusted is rebuilt if adjusting increased its cost by more
            than this factor.
        progress : callable, optional
            Called with (triangles placed, triangles) if it is rebuilt.

        Returns
        -------
        structure : Structure
        report : UpdateReport
        """
        started = time.perf_counter()
        structure = type(self)(triangles, self.options, progress=progress)
        seconds = time.perf_counter() - started
        return structure, UpdateReport(True, seconds, math.nan, math.nan)


def _restored(
    made: type[Structure], triangles: Triangles, arrays: Mapping[str, NDArray[Any]], options: Any
) -> Structure:
    return made.from_arrays(triangles, arrays, options)
