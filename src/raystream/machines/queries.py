"""Queries: what a tracer is asked. Arguments are checked here, and become a `Query`."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits, MultiHits
from raystream.core.query import UNLIMITED, Crossings, Kind, Query, counts_surfaces
from raystream.core.rays import RayArrays, RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.sink import Sink
from raystream.machines.backend import Backend
from raystream.programs.filters import Bound, Filter
from raystream.programs.payloads import as_payload, as_records
from raystream.programs.trace import Order, check_order
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.machines.counters import RayCounters

__all__ = ["Queries"]


#: Queries without options, made once: a small batch takes little more time than a value.
_PLAIN = [Query(kind) for kind in Kind]


class Queries:
    """The queries of a tracer.

    Attributes
    ----------
    structure : Structure
        What rays are traced in.
    """

    structure: Structure
    _backend: Backend
    _counts: bool
    _latest: RayCounters | None

    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        progress: Progress | None = None,
    ) -> Hits:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        origins, directions : array_like of shape S + (3,), real
        t_min, t_max : float or array_like that broadcasts to S
            Closed search interval, in direction lengths.
        on_hit : callable, optional
            A filter: ``on_hit(hit)`` gets a `Hit` and returns whether it exists, as a boolean
            or as `Decision.CONTINUE` or `Decision.IGNORE`; `Decision.STOP` means that it does,
            and no later one. See `trace` for what it may do. A `Bound` hands it constants.
        skip_prim_ids : array_like of shape S or S + (k,), int, optional
            Triangles that do not exist for each ray, such as those that it starts on; -1 for
            none. The filter is not asked about them. With rays in arrays on a GPU, it may be
            one there, of int32 or int64.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        Hits
            ``t``, ``u``, ``v`` of shape S, float32, and ``prim_id`` of shape S, int32. A
            miss has ``t = inf`` and ``prim_id = -1``. Of rays in arrays on a GPU:
            `raystream.cuda.device_hits.DeviceHits`, there.

        Raises
        ------
        ValueError, TypeError
            If shapes disagree or an array does not hold real numbers; and see `trace`.
        RuntimeError
            If the filter raises something, which is then the cause.

        Notes
        -----
        Equal t, before it is rounded to float32: the lowest prim_id wins, in every structure.
        """
        rays = self._rays(origins, directions, t_min, t_max)
        query = self._query(Kind.FIRST_HIT, rays, on_hit, skip_prim_ids)
        if isinstance(rays, RayArrays):
            found: Hits = self._backend.answer_on_device(query, rays, progress)
            return found
        sink, shape = self._answer(query, rays, progress), rays.shape
        t, u, v, prim_id = sink.hits
        return Hits(
            t.reshape(shape),
            u.reshape(shape),
            v.reshape(shape),
            prim_id.reshape(shape),
            sink.status.reshape(shape),
            self.structure.triangles,
        )

    def any_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; cheaper than the nearest hit.

        Parameters
        ----------
        origins, directions, t_min, t_max, on_hit, skip_prim_ids, progress
            See `first_hit`.

        Returns
        -------
        ndarray of shape S, bool
            Exactly where `first_hit` would report a hit. Of rays in arrays on a GPU: an array
            there, a `raystream.jit.cuda.DeviceArray`.

        Raises
        ------
        ValueError, TypeError, RuntimeError
            See `first_hit`.
        """
        rays = self._rays(origins, directions, t_min, t_max)
        query = self._query(Kind.ANY_HIT, rays, on_hit, skip_prim_ids)
        if isinstance(rays, RayArrays):
            seen: NDArray[np.bool_] = self._backend.answer_on_device(query, rays, progress)
            return seen
        return self._answer(query, rays, progress).seen.reshape(rays.shape)

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: Crossings = "triangles",
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count what lies along each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max, on_hit, skip_prim_ids, progress
            See `first_hit`.
        crossings : {"triangles", "surfaces"}
            What a ray exactly through an edge or a vertex meets: every triangle there, or
            one triangle each time that it passes through the surface (none or two where it
            only grazes it), so that a closed mesh is crossed an even number of times by a
            ray from outside.

        Returns
        -------
        ndarray of shape S, int64
            Of rays in arrays on a GPU: an array there, a `raystream.jit.cuda.DeviceArray`.

        Raises
        ------
        ValueError, TypeError, RuntimeError
            As `first_hit`, or if `crossings` is unknown.
        """
        surfaces = counts_surfaces(crossings)
        rays = self._rays(origins, directions, t_min, t_max)
        query = self._query(Kind.COUNT_HITS, rays, on_hit, skip_prim_ids, surfaces)
        if isinstance(rays, RayArrays):
            counts: NDArray[np.int64] = self._backend.answer_on_device(query, rays, progress)
            return counts
        return self._answer(query, rays, progress).counts.reshape(rays.shape)

    def multi_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        max_hits: int | None = None,
        crossings: Crossings = "triangles",
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        progress: Progress | None = None,
    ) -> MultiHits:
        """Find all hits of each ray, or the nearest few, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max, on_hit, skip_prim_ids
            See `first_hit`.
        max_hits : int, optional
            Keep the nearest `max_hits` of each ray; without it all of them, however many.
        crossings : {"triangles", "surfaces"}
            See `count_hits`.
        progress : callable, optional
            Called with (steps done, steps): a ray may take two, to count its hits
            and to keep them.

        Returns
        -------
        MultiHits
            ``ray_splits`` of shape (N + 1,), int64, delimits each ray's rows of ``t``,
            ``u``, ``v`` (float32) and ``prim_id`` (int32). Of rays in arrays on a GPU:
            `raystream.cuda.device_hits.DeviceMultiHits`, there.

        Raises
        ------
        ValueError, TypeError, RuntimeError
            As `first_hit`, or if `crossings` is unknown or `max_hits` negative.
        MemoryError
            If all hits together need more memory than there is: nothing is cut off
            silently. Give `max_hits`, or fewer rays.

        Notes
        -----
        Exact: hits are kept in memory that grows, or counted before they are written. Equal
        t, before it is rounded to float32: the lower prim_id comes first. No hit is found
        twice and none is lost between two others, however close.
        """
        surfaces = counts_surfaces(crossings)
        limit = UNLIMITED if max_hits is None else min(operator.index(max_hits), UNLIMITED)
        if limit < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
        rays = self._rays(origins, directions, t_min, t_max)
        query = self._query(Kind.MULTI_HIT, rays, on_hit, skip_prim_ids, surfaces, limit)
        if isinstance(rays, RayArrays):
            found: MultiHits = self._backend.answer_on_device(query, rays, progress)
            return found
        sink = self._answer(query, rays, progress)
        status = sink.status.reshape(rays.shape)
        return MultiHits(sink.splits, *sink.hits, status, self.structure.triangles)

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
            and its own ray's payload, which it changes in place, and returns `Decision.CONTINUE`,
            `Decision.STOP` (no more hits of this ray) or `Decision.IGNORE` (here the same);
            nothing means to continue.
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
        surfaces = counts_surfaces(crossings)
        check_order(order)
        query = Query(Kind.TRACE, surfaces, is_ordered=order != "any", on_hit=on_hit)
        rays = self._rays(origins, directions, t_min, t_max)
        if isinstance(rays, RayArrays):
            there: NDArray[Any] | None
            there = self._backend.answer_on_device(query, rays, progress, payload)
            return there
        self._check_programs()
        if payload is None:
            self._answer(query, rays, progress)
            return None
        result = as_payload(payload, rays.shape)
        records = as_records(result, rays.shape)
        self._answer(query, rays, progress, records)
        if not np.shares_memory(result, records):
            result[...] = records.reshape(result.shape)
        return result

    def bands_on_device(self, context: Any) -> Any:
        """What takes samples of a picture on the tracer's device; None if the host does.

        The host does if the backend does not shade, or a subclass overrides queries, which the
        renderer must then call.

        Parameters
        ----------
        context : rendering.integrator.RenderContext

        Returns
        -------
        rendering.device_bands.DeviceBands or None
        """
        own = type(self)
        is_usual = own.first_hit is Queries.first_hit and own.any_hit is Queries.any_hit
        if not (self._backend.capabilities.shading and is_usual) or self._counts:
            return None
        return self._backend.bands_on_device(context)

    def _rays(self, origins: Any, directions: Any, t_min: Any, t_max: Any) -> RayBatch | RayArrays:
        """The rays in the host's memory; or as they are, if the backend reads them there."""
        if self._backend.capabilities.device_arrays and not self._counts:
            arrays = RayArrays(origins, directions, t_min, t_max)
            if arrays.is_on_gpu():
                return arrays
        return RayBatch(origins, directions, t_min, t_max)

    def _query(
        self,
        kind: Kind,
        rays: RayBatch | RayArrays,
        on_hit: Any,
        skip_prim_ids: Any,
        surfaces: bool = False,
        limit: int = UNLIMITED,
    ) -> Query:
        if on_hit is None and skip_prim_ids is None:
            if limit == UNLIMITED and not surfaces:
                return _PLAIN[kind]
            return Query(kind, surfaces, limit)
        triangles = self.structure.triangles
        if isinstance(rays, RayArrays):
            chosen: Filter | None = Filter.among(on_hit, skip_prim_ids, triangles)
        else:
            chosen = Filter.of(on_hit, skip_prim_ids, rays.shape, triangles)
            if limit:
                self._check_programs()
        return Query(kind, surfaces, limit, on_hit=chosen)

    def _check_programs(self) -> None:
        if self._counts:
            raise ValueError(
                "on_hit, skip_prim_ids: a tracer with counters=True counts whole queries, "
                "and programs take several; use another tracer"
            )
        if not self._backend.capabilities.programs:
            raise ValueError("on_hit, skip_prim_ids: programs do not run on this tracer's device")

    def _answer(
        self, query: Query, rays: RayBatch, progress: Progress | None, records: Any = None
    ) -> Sink:
        if not self._counts:
            return self._backend.answer(query, rays, progress, records)
        from raystream.machines.counters import answer_counting

        sink, self._latest = answer_counting(self._backend, query, rays, progress)
        return sink
