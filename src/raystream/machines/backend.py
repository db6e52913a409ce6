"""Backend: runs queries on a structure, and declares its capabilities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayArrays, RayBatch
from raystream.jit.threads import Progress, part_of
from raystream.kernels.hits import Sink, allocate_hits
from raystream.programs.run import run_on_hits
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.kernels.point_queries import NearestArrays, PointBatch
    from raystream.machines.passes import Passes

#: Backends that copy rays take a block of at most this many at a time, see `ray_block`; and bytes
#: of such a ray.
_BLOCK_RAYS, _BLOCK_BYTES = 1 << 20, 120


class Capabilities(NamedTuple):
    """Features of a backend beyond queries of rays in host memory.

    Attributes
    ----------
    device_arrays : bool
        It reads rays from arrays on a GPU, and leaves the results there: `answer_on_device`.
    programs : bool
        It supports filters and programs.
    shading : bool
        It renders on its device: `bands_on_device`.
    passes : bool
        It runs in passes, and can record them: `recording`.
    loops : bool
        It runs a renderer's rays and shading in one loop: `run_loop`.
    points : bool
        It finds the triangles nearest to points: `find_nearest`.
    masks : bool
        It asks for the masks of rays and geometry.
    """

    device_arrays: bool = False
    programs: bool = True
    shading: bool = False
    passes: bool = False
    loops: bool = False
    points: bool = False
    masks: bool = False


class Backend(ABC):
    """Runs queries on a structure.

    Attributes
    ----------
    structure : Structure
    capabilities : Capabilities
    """

    capabilities: ClassVar[Capabilities] = Capabilities()
    structure: Structure

    @abstractmethod
    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query of any kind but `Kind.TRACE`, without its filter.

        Parameters
        ----------
        query : Query
        rays : RayBatch
            World space.
        sink : Sink
            Made for the query.
        progress : callable, optional
            Called with (steps done, steps), one or two steps per ray.

        Raises
        ------
        MemoryError
            If the hits do not fit into memory.
        """

    def caster(self) -> Callable[..., Any] | None:
        """A function for the nearest hit of a single ray; None if only `run` finds it.

        Returns
        -------
        callable or None
            ``cast((ox, oy, oz, dx, dy, dz, t_min, t_max)) -> ((t, u, v, prim_id), status)``:
            Python floats in world space to Python numbers. Several threads may call it.
        """
        return None

    def run_program(
        self,
        query: Query,  # noqa: ARG002 - for backends that run programs
        rays: RayBatch,  # noqa: ARG002
        sink: Sink,  # noqa: ARG002
        progress: Progress | None = None,  # noqa: ARG002
    ) -> bool:
        """Run a query with its filter or program; False if the CPU has to run those."""
        return False

    def answer(
        self,
        query: Query,
        rays: RayBatch,
        progress: Progress | None = None,
        records: Any = None,
    ) -> Sink:
        """Run a query of any kind, with its filter or program.

        Parameters
        ----------
        query : Query
        rays : RayBatch
        progress : callable, optional
        records : ndarray, optional
            See `Sink`.

        Returns
        -------
        Sink
        """
        kind = self.structure.triangles.number_type
        sink = Sink.of(query, len(rays), records, kind=kind)
        is_program = query.kind is Kind.TRACE
        if not is_program and (query.on_hit is None or query.limit == 0):
            plain = query if query.on_hit is None else query._replace(on_hit=None)
            self.run(plain, rays, sink, progress)
        elif self.run_program(query, rays, sink, progress):
            pass
        elif query.kind is Kind.ANY_HIT:
            # The nearest hit that exists says whether there is one.
            first = self.answer(query._replace(kind=Kind.FIRST_HIT), rays, progress)
            sink.status, sink.seen = first.status, first.hits.prim_id >= 0
        else:
            run_on_hits(self.run, query, rays, sink, self.structure.triangles, progress)
        return sink

    def count_then_fill(
        self,
        query: Query,
        rays: RayBatch,
        sink: Sink,
        progress: Progress | None,
        fill: Callable[[Sink, Progress | None], None],
    ) -> None:
        """Answer `Kind.MULTI_HIT` by two searches, of which the first counts the hits.

        Parameters
        ----------
        query, rays, sink, progress
            See `run`.
        fill : callable
            ``fill(filled, progress)`` writes the hits to a sink with `splits`, and uninitialised
            `hits`. It shares status and tallies with `sink`, which include both searches.
        """
        count = len(rays)
        filled = Sink(sink.status, tallies=sink.tallies)
        filled.splits = np.zeros(count + 1, np.int64)
        if query.limit == 0:  # any hit finds the invalid rays
            seen = Query(Kind.ANY_HIT)
            self.run(seen, rays, Sink.of(seen, count, status=sink.status))
        else:
            counted = Sink(sink.status, tallies=sink.tallies)
            counted.counts = np.empty(count, np.int64)
            half = part_of(progress, 0, count, 2 * count)
            self.run(query._replace(kind=Kind.COUNT_HITS), rays, counted, half)
            np.cumsum(counted.counts, out=filled.splits[1:])
        kind = self.structure.triangles.number_type
        filled.hits = allocate_hits(int(filled.splits[-1]), kind)
        fill(filled, part_of(progress, count, count, 2 * count))
        sink.put(filled.splits, filled.hits)

    def working_bytes(self, kind: Kind, ray_count: int, hit_count: int) -> int:
        """Most bytes of the host's memory that `run` needs besides the results.

        Parameters
        ----------
        kind : Kind
            Not `Kind.TRACE`.
        ray_count, hit_count : int
            The hits are those of `Kind.MULTI_HIT`.
        """
        del hit_count
        counts = 16 * ray_count if kind is Kind.MULTI_HIT else 0  # see `count_then_fill`
        return counts + _BLOCK_BYTES * min(ray_count, _BLOCK_RAYS)

    def answer_on_device(
        self,
        query: Query,
        rays: RayArrays,
        progress: Progress | None = None,
        payload: Any = None,
    ) -> Any:
        """Run a query of rays on the device, where the results stay.

        Parameters
        ----------
        query : Query
            The triangles that a filter skips are as the caller gave them.
        rays : RayArrays
        progress : callable, optional
        payload : array, dtype or None
            Of `Kind.TRACE`: see `Tracer.trace`.

        Returns
        -------
        object
            The result of the tracer's query of this kind for rays on a device.
        """
        raise NotImplementedError

    def find_nearest(
        self, batch: PointBatch, out: NearestArrays, progress: Progress | None = None
    ) -> None:
        """Find the triangles nearest to points in host memory, for backends with `points`.

        Parameters
        ----------
        batch : PointBatch
        out : NearestArrays
            On the host.
        progress : callable, optional
            Called with (points done, points).
        """
        raise NotImplementedError

    def bands_on_device(self, context: Any) -> Any:
        """The renderer on the device, or None; see `Tracer.bands_on_device`."""
        raise NotImplementedError

    def recording(self, passes: Passes) -> Backend:
        """A copy of the backend that adds its passes to a record."""
        raise NotImplementedError
