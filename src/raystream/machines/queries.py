"""Queries: what a tracer is asked, and how a machine answers it."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits, MultiHits
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.queries import UNLIMITED
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries

if TYPE_CHECKING:
    from raystream.machines.counting import Counting

__all__ = ["Crossings", "Queries"]

Crossings = Literal["triangles", "surfaces"]


class Queries:
    """The four queries of a tracer.

    Attributes
    ----------
    structure : Structure
        What rays are traced in.
    """

    structure: Structure
    _machine: BatchQueries | Counting

    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        progress: Progress | None = None,
    ) -> Hits:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        origins, directions : array_like of shape S + (3,), real
        t_min, t_max : float or array_like that broadcasts to S
            Closed search interval, in direction lengths.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        Hits
            ``t``, ``u``, ``v`` of shape S, float32, and ``prim_id`` of shape S, int32. A
            miss has ``t = inf`` and ``prim_id = -1``.

        Raises
        ------
        ValueError, TypeError
            If shapes disagree or an array does not hold real numbers.

        Notes
        -----
        Equal t, before it is rounded to float32: the lowest prim_id wins, in every structure.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        status = np.zeros(len(batch), np.uint8)
        t, u, v, prim_id = self._machine.first_hit_batch(batch, status, progress)
        shape = batch.shape
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
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; cheaper than the nearest hit.

        Parameters
        ----------
        origins, directions, t_min, t_max, progress
            See `first_hit`.

        Returns
        -------
        ndarray of shape S, bool
            Exactly where `first_hit` would report a hit.

        Raises
        ------
        ValueError, TypeError
            See `first_hit`.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        status = np.zeros(len(batch), np.uint8)
        return self._machine.any_hit_batch(batch, status, progress).reshape(batch.shape)

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: Crossings = "triangles",
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count what lies along each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max, progress
            See `first_hit`.
        crossings : {"triangles", "surfaces"}
            What a ray exactly through an edge or a vertex meets: every triangle there, or
            one triangle each time that it passes through the surface (none or two where it
            only grazes it), so that a closed mesh is crossed an even number of times by a
            ray from outside.

        Returns
        -------
        ndarray of shape S, int64

        Raises
        ------
        ValueError, TypeError
            As `first_hit`, or if `crossings` is unknown.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        surfaces = _is_surfaces(crossings)
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
        progress: Progress | None = None,
    ) -> MultiHits:
        """Find all hits of each ray, or the nearest few, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max
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
            ``u``, ``v`` (float32) and ``prim_id`` (int32).

        Raises
        ------
        ValueError, TypeError
            As `first_hit`, or if `crossings` is unknown or `max_hits` negative.
        MemoryError
            If all hits together need more memory than there is: nothing is cut off
            silently. Give `max_hits`, or fewer rays.

        Notes
        -----
        Exact: hits are counted before they are written, or kept in memory that grows. Equal
        t, before it is rounded to float32: the lower prim_id comes first. No hit is found
        twice and none is lost between two others, however close.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        surfaces = _is_surfaces(crossings)
        limit = UNLIMITED if max_hits is None else min(operator.index(max_hits), UNLIMITED)
        if limit < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
        status = np.zeros(len(batch), np.uint8)
        splits, hits = self._machine.multi_hit_batch(batch, surfaces, limit, status, progress)
        return MultiHits(splits, *hits, status.reshape(batch.shape), self.structure.triangles)


def _is_surfaces(crossings: str) -> bool:
    if crossings not in ("triangles", "surfaces"):
        raise ValueError(f"crossings: expected 'triangles' or 'surfaces', got {crossings!r}")
    return crossings == "surfaces"
