"""Traces: a tracer's query that runs a program at hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.machines.on_device import on_device, programs_there
from raystream.programs.filters import Filter, count_filtered, filter_first, multi_filtered
from raystream.programs.rounds import AskHits
from raystream.programs.trace import Order, check_order, trace_program
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries
from raystream.structures.found import FoundVisitor

if TYPE_CHECKING:
    from raystream.machines.counting import Counting

__all__ = ["Traces", "is_surfaces"]


class Traces:
    """The query of a tracer that runs a program; and what filtered queries share with it.

    Attributes
    ----------
    structure : Structure
        What rays are traced in.
    """

    structure: Structure
    _counts: bool
    _machine: BatchQueries | Counting

    def trace(
        self,
        origins: Any,
        directions: Any,
        *,
        on_hit: Callable[..., Any],
        payload: Any = None,
        order: Order = "front-to-back",
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: str = "triangles",
        progress: Progress | None = None,
    ) -> NDArray[Any] | None:
        """Run a function at the hits of each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`.
        on_hit : callable
            ``on_hit(hit, payload)``, a Python function that Numba compiles. It gets a `Hit`
            and its own ray's payload, which it changes in place, and returns `CONTINUE`,
            `STOP` (no more hits of this ray) or `IGNORE` (here the same as `CONTINUE`);
            nothing means `CONTINUE`.
        payload : ndarray or dtype, optional
            A writable array of the rays' shape S, which is changed in place; a dtype makes
            one of zeros. With a structured dtype a function gets its ray's record, as in
            ``payload.depth += hit.t``. Plain numbers, of shape S or S + (k,), it gets as an
            array of one or k numbers, as in ``payload[0] += 1``. Without a payload it gets
            None. Of rays in arrays on a GPU: an array there is changed there, a dtype makes
            one there, whose fields are aligned, and a NumPy array is copied there and back.
        order : {"front-to-back", "any"}
            Hits of a ray come by increasing t, then prim_id; or as they are found, for
            functions to which the order does not matter: packets of rays save sorting them.
        crossings : {"triangles", "surfaces"}
            See `count_hits`.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        ndarray or None
            The payload: the array that was given, or the new one; of rays in arrays on a GPU,
            a new one is a `raystream.jit.cuda.DeviceArray`.

        Raises
        ------
        ValueError
            If shapes disagree, `order` or `crossings` is unknown, the payload is read-only,
            or the tracer counts (``counters=True``).
        TypeError
            If the function cannot be compiled, or takes other arguments, or returns something
            else than a decision; if the payload is no array or dtype of numbers and records.
            If rays are in arrays on a GPU, and the function cannot run there.
        RuntimeError
            If the function raises something, which is then the cause.

        Notes
        -----
        Rays are independent, and run on several threads. A function that is new is compiled
        when it is first used, in a second or two, and kept on disk if all that it uses can be
        told apart by its content (as `raystream.streams.Kernel` does). Variables from outside
        are constants. After an exception or Ctrl-C the payload of some rays has changed.

        Examples
        --------
        >>> import raystream as rs
        >>> tracer = rs.Tracer(rs.load("cornell"))
        >>> def farthest(hit, payload):
        ...     payload[0] = hit.t
        >>> far = tracer.trace([278, 273, -800], [0, 0, 1], on_hit=farthest, payload=float)
        >>> round(far.item(), 1)
        1359.2
        """
        surfaces = is_surfaces(crossings)
        check_order(order)
        rays = on_device(self._machine, None, None, origins, directions, t_min, t_max)
        if rays is not None:
            return rays.trace(on_hit, payload, surfaces, progress)
        batch = RayBatch(origins, directions, t_min, t_max)
        ask, there = self._ask_hits(surfaces), programs_there(self._machine)

        def run_there(function: Any, records: NDArray[Any] | None) -> bool:
            return there is not None and there.trace(batch, function, records, surfaces, progress)

        triangles = self.structure.triangles
        return trace_program(ask, batch, triangles, on_hit, payload, order, progress, run_there)

    def _filter(self, on_hit: Any, skip_prim_ids: Any, shape: tuple[int, ...]) -> Filter | None:
        return Filter.of(on_hit, skip_prim_ids, shape, self.structure.triangles)

    def _filtered_first(
        self,
        chosen: Filter,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> HitArrays:
        """The nearest hits that exist: found on the machine's device, if it runs the filter."""
        ask, there = self._ask_hits(False), programs_there(self._machine)
        hits = None if there is None else there.first_hit(chosen, batch, status, progress)
        if hits is None:
            hits = self._machine.first_hit_batch(batch, status, progress)
            filter_first(chosen, ask, batch, hits)
        return hits

    def _filtered_counts(
        self, chosen: Filter, batch: RayBatch, surfaces: bool, progress: Progress | None
    ) -> NDArray[np.int64]:
        ask, there = self._ask_hits(surfaces), programs_there(self._machine)
        counts = None if there is None else there.count_hits(chosen, batch, surfaces, progress)
        return count_filtered(chosen, ask, batch, progress) if counts is None else counts

    def _filtered_hits(
        self,
        chosen: Filter,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> tuple[NDArray[np.int64], HitArrays]:
        ask, there = self._ask_hits(surfaces), programs_there(self._machine)
        found = None
        if there is not None:
            found = there.multi_hit(chosen, batch, surfaces, limit, status, progress)
        return found or multi_filtered(chosen, ask, batch, limit, status, progress)

    def _ask_hits(self, surfaces: bool) -> AskHits:
        """The query that programs run on.

        Raises
        ------
        ValueError
            If there is none.
        """
        machine = self._machine
        if not isinstance(machine, BatchQueries):
            raise ValueError(
                "on_hit, skip_prim_ids: a tracer with counters=True counts whole queries, "
                "and programs take several; use another tracer"
            )
        if not getattr(self.structure, "runs_programs", True):
            raise ValueError("on_hit, skip_prim_ids: programs do not run on this tracer's device")

        def ask(
            batch: RayBatch,
            limit: int,
            is_ordered: bool,
            visitor: FoundVisitor,
            status: NDArray[np.uint8],
            progress: Progress | None,
        ) -> None:
            machine.visit_hits_batch(batch, surfaces, limit, is_ordered, visitor, status, progress)

        return ask


def is_surfaces(crossings: str) -> bool:
    """Whether surfaces are to be counted; raises ValueError for an unknown word."""
    if crossings not in ("triangles", "surfaces"):
        raise ValueError(f"crossings: expected 'triangles' or 'surfaces', got {crossings!r}")
    return crossings == "surfaces"
