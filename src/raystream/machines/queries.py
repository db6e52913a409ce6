"""Queries: what a tracer is asked, and how a machine answers it."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits, MultiHits
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.queries import UNLIMITED
from raystream.machines.on_device import on_device
from raystream.machines.programs import Traces, is_surfaces
from raystream.programs.filters import Bound

__all__ = ["Crossings", "Queries"]

Crossings = Literal["triangles", "surfaces"]


class Queries(Traces):
    """The queries of a tracer; see `Traces` for the one that runs a program."""

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
            or as `CONTINUE` or `IGNORE`; `STOP` means that it does, and no later one. See
            `trace` for what it may do. A `Bound` hands it constants.
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
        there = on_device(self._machine, on_hit, skip_prim_ids, origins, directions, t_min, t_max)
        if there is not None:
            return there.first_hit(progress)
        batch = RayBatch(origins, directions, t_min, t_max)
        status = np.zeros(len(batch), np.uint8)
        shape = batch.shape
        chosen = self._filter(on_hit, skip_prim_ids, shape)
        if chosen is None:
            t, u, v, prim_id = self._machine.first_hit_batch(batch, status, progress)
        else:
            t, u, v, prim_id = self._filtered_first(chosen, batch, status, progress)
        return Hits(
            t.reshape(shape),
            u.reshape(shape),
            v.reshape(shape),
            prim_id.reshape(shape),
            status.reshape(shape),
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
        there = on_device(self._machine, on_hit, skip_prim_ids, origins, directions, t_min, t_max)
        if there is not None:
            return there.any_hit(progress)
        batch = RayBatch(origins, directions, t_min, t_max)
        status = np.zeros(len(batch), np.uint8)
        chosen = self._filter(on_hit, skip_prim_ids, batch.shape)
        if chosen is None:
            return self._machine.any_hit_batch(batch, status, progress).reshape(batch.shape)
        hits = self._filtered_first(chosen, batch, status, progress)
        return (hits.prim_id >= 0).reshape(batch.shape)

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
        surfaces = is_surfaces(crossings)
        there = on_device(self._machine, on_hit, skip_prim_ids, origins, directions, t_min, t_max)
        if there is not None:
            return there.count_hits(surfaces, progress)
        batch = RayBatch(origins, directions, t_min, t_max)
        chosen = self._filter(on_hit, skip_prim_ids, batch.shape)
        if chosen is not None:
            return self._filtered_counts(chosen, batch, surfaces, progress).reshape(batch.shape)
        status = np.zeros(len(batch), np.uint8)
        counts = self._machine.count_hits_batch(batch, surfaces, UNLIMITED, status, progress)
        return counts.reshape(batch.shape)

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
        surfaces = is_surfaces(crossings)
        limit = UNLIMITED if max_hits is None else min(operator.index(max_hits), UNLIMITED)
        if limit < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
        there = on_device(self._machine, on_hit, skip_prim_ids, origins, directions, t_min, t_max)
        if there is not None:
            return there.multi_hit(surfaces, limit, progress)
        batch = RayBatch(origins, directions, t_min, t_max)
        status = np.zeros(len(batch), np.uint8)
        chosen = self._filter(on_hit, skip_prim_ids, batch.shape)
        if chosen is None or limit == 0:
            splits, hits = self._machine.multi_hit_batch(batch, surfaces, limit, status, progress)
        else:
            splits, hits = self._filtered_hits(chosen, batch, surfaces, limit, status, progress)
        return MultiHits(splits, *hits, status.reshape(batch.shape), self.structure.triangles)

    def bands_on_device(self, setting: Any) -> Any:
        """What takes samples of a picture where the tracer's rays are; None if the host does.

        It does if the machine shades nothing, or a subclass has queries of its own, which are to
        be asked.

        Parameters
        ----------
        setting : rendering.sampled.Setting

        Returns
        -------
        rendering.device_bands.DeviceBands or None
        """
        own, make = type(self), getattr(self._machine, "bands_on_device", None)
        is_usual = own.first_hit is Queries.first_hit and own.any_hit is Queries.any_hit
        return make(setting) if make is not None and is_usual else None
