"""Backend: what answers queries, and what it can do besides."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayArrays, RayBatch
from raystream.jit.threads import Progress, part_of
from raystream.kernels.hit_batch import allocate_hits
from raystream.kernels.sink import Sink
from raystream.programs.run import run_on_hits
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.machines.passes import Passes

__all__ = ["Backend", "Capabilities"]


class Capabilities(NamedTuple):
    """What a backend can do besides answering queries of rays in the host's memory.

    Attributes
    ----------
    device_arrays : bool
        It reads rays from arrays on a GPU, and leaves the answers there: `answer_on_device`.
    programs : bool
        Filters and programs can be run on its queries.
    shading : bool
        It takes samples of pictures on its device: `bands_on_device`.
    passes : bool
        It runs passes, and can keep a record of them: `recording`.
    """

    device_arrays: bool = False
    programs: bool = True
    shading: bool = False
    passes: bool = False


class Backend(ABC):
    """Answers queries about a structure.

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
        """Answer a query of any kind but `Kind.TRACE`, without regard to its filter.

        Parameters
        ----------
        query : Query
        rays : RayBatch
            World space.
        sink : Sink
            Made for the query.
        progress : callable, optional
            Called with (steps done, steps): rays, or twice as many.

        Raises
        ------
        MemoryError
            If the hits need more memory than there is.
        """

    def run_program(
        self,
        query: Query,  # noqa: ARG002 - for backends that run programs
        rays: RayBatch,  # noqa: ARG002
        sink: Sink,  # noqa: ARG002
        progress: Progress | None = None,  # noqa: ARG002
    ) -> bool:
        """Answer a query with its filter or program; False if the CPU has to run that."""
        return False

    def answer(
        self,
        query: Query,
        rays: RayBatch,
        progress: Progress | None = None,
        records: Any = None,
    ) -> Sink:
        """Answer a query of any kind, with its filter or program.

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
        sink = Sink.of(query, len(rays), records)
        is_program = query.kind is Kind.TRACE
        if not is_program and (query.on_hit is None or query.limit == 0):
            self.run(query, rays, sink, progress)
        elif query.kind is Kind.ANY_HIT:
            # The nearest hit that exists says whether there is one.
            first = self.answer(query._replace(kind=Kind.FIRST_HIT), rays, progress)
            sink.status, sink.seen = first.status, first.hits.prim_id >= 0
        elif not self.run_program(query, rays, sink, progress):
            run_on_hits(self.run, query, rays, sink, self.structure.triangles, progress)
        return sink

    def room_for_hits(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None
    ) -> tuple[Sink, Progress | None]:
        """Count the hits of `Kind.MULTI_HIT`, for a backend that finds them afterwards.

        Returns
        -------
        filled : Sink
            With `splits`, and `hits` not initialised; status and tallies are those of `sink`, and
            get what rays meet both times.
        progress : callable or None
            For the second half.
        """
        count = len(rays)
        filled = Sink(sink.status, tallies=sink.tallies)
        filled.splits = np.zeros(count + 1, np.int64)
        if query.limit == 0:  # any hit tells which rays are invalid
            seen = Query(Kind.ANY_HIT)
            self.run(seen, rays, Sink.of(seen, count, status=sink.status))
        else:
            counted = Sink(sink.status, tallies=sink.tallies)
            counted.counts = np.empty(count, np.int64)
            half = part_of(progress, 0, 2 * count)
            self.run(query._replace(kind=Kind.COUNT_HITS), rays, counted, half)
            np.cumsum(counted.counts, out=filled.splits[1:])
        filled.hits = allocate_hits(int(filled.splits[-1]))
        return filled, part_of(progress, count, 2 * count)

    def answer_on_device(
        self,
        query: Query,
        rays: RayArrays,
        progress: Progress | None = None,
        payload: Any = None,
    ) -> Any:
        """Answer a query of rays on the device, where the answers stay.

        Parameters
        ----------
        query : Query
            A filter's skipped triangles are as the caller gave them.
        rays : RayArrays
        progress : callable, optional
        payload : array, dtype or None
            Of `Kind.TRACE`: see `Tracer.trace`.

        Returns
        -------
        object
            What the tracer's query of this kind returns for rays on a device.
        """
        raise NotImplementedError

    def bands_on_device(self, context: Any) -> Any:
        """What takes samples of a picture on the device, or None; see `Tracer.bands_on_device`."""
        raise NotImplementedError

    def recording(self, passes: Passes) -> Backend:
        """The same backend, which adds its passes to a record."""
        raise NotImplementedError
