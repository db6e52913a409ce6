"""BatchQueries: the queries for whole batches, around those for local rays."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, part_of
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.queries import UNLIMITED, LocalRays
from raystream.structures.found import Found, FoundVisitor, allocate_hits, cut
from raystream.structures.ray_block import blocks

__all__ = ["BatchQueries"]


class BatchQueries(ABC):
    """Queries for whole batches, in world space: what a tracer asks.

    Batches are turned into local rays, a block at a time, for the queries that a subclass
    gives. One that does better overrides them.
    """

    @property
    @abstractmethod
    def frame(self) -> SceneFrame:
        """The triangles' local frame, as kernels take it."""

    @abstractmethod
    def first_hit(
        self,
        rays: LocalRays,
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> None:
        """Find the nearest hit of each ray; a miss has t = inf and prim_id = -1.

        Parameters
        ----------
        rays : LocalRays
        out : HitArrays
            Row i is written for ray i.
        progress : callable, optional
            Called with (rays done, rays to do).
        tallies : ndarray of shape (N, 8), uint32, optional
            What each ray meets is added to its row; see `kernels.tally`.
        """

    @abstractmethod
    def any_hit(
        self,
        rays: LocalRays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way."""

    @abstractmethod
    def count_hits(
        self,
        rays: LocalRays,
        surfaces: bool,
        limit: int = UNLIMITED,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`."""

    @abstractmethod
    def multi_hit(
        self,
        rays: LocalRays,
        surfaces: bool,
        splits: NDArray[np.int64],
        out: HitArrays,
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
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

    def first_hit_batch(
        self,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> HitArrays:
        """Find the nearest hit of each ray; a miss has t = inf and prim_id = -1.

        Parameters
        ----------
        batch : RayBatch
        status : ndarray of shape (N,), uint8
            A `RayStatus` for each ray: VALID on entry, changed for invalid ones.
        progress : callable, optional
            Called with (rays done, rays).
        tallies : ndarray of shape (N, 8), uint32, optional
            What each ray meets is added to its row; see `kernels.tally`.

        Returns
        -------
        HitArrays
            Row i is of ray i, with t in world direction lengths.
        """
        out = HitArrays.empty(len(batch))
        for block in blocks(batch, self.frame, status, progress):
            part = out.part(block.rows)
            self.first_hit(block.rays, part, block.progress, block.part_of(tallies))
            block.to_world(part.t, np.arange(len(part.t) + 1))
        return out

    def any_hit_batch(
        self,
        batch: RayBatch,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; returns shape (N,), bool."""
        seen = np.empty(len(batch), np.bool_)
        for block in blocks(batch, self.frame, status, progress):
            seen[block.rows] = self.any_hit(block.rays, block.progress, block.part_of(tallies))
        return seen

    def count_hits_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`; returns shape (N,), int64."""
        counts = np.empty(len(batch), np.int64)
        for block in blocks(batch, self.frame, status, progress):
            counts[block.rows] = self.count_hits(
                block.rays, surfaces, limit, block.progress, block.part_of(tallies)
            )
        return counts

    def multi_hit_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
        tallies: NDArray[np.uint32] | None = None,
    ) -> tuple[NDArray[np.int64], HitArrays]:
        """Find the nearest `limit` hits of each ray, by t, then prim_id.

        They are counted first, so that their room is known: `tallies` get what rays meet
        both times.

        Returns
        -------
        splits : ndarray of shape (N + 1,), int64
            Ray i owns rows splits[i] to splits[i + 1].
        hits : HitArrays
            With t in world direction lengths.

        Raises
        ------
        MemoryError
            If the hits need more memory than there is.
        """
        splits = np.zeros(len(batch) + 1, np.int64)
        if limit:
            first_half = part_of(progress, 0, 2 * len(batch))
            counts = self.count_hits_batch(batch, surfaces, limit, status, first_half, tallies)
            np.cumsum(counts, out=splits[1:])
        hits = allocate_hits(int(splits[-1]))
        second_half = part_of(progress, len(batch), 2 * len(batch))
        for block in blocks(batch, self.frame, status, second_half):
            rows = splits[block.rows.start : block.rows.stop + 1]
            part = block.part_of(tallies)
            self.multi_hit(block.rays, surfaces, rows, hits, block.progress, part)
            block.to_world(hits.t, rows)
        return splits, hits

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
        """Give the nearest `limit` hits of each ray to a function, in parts.

        Parameters
        ----------
        batch : RayBatch
        surfaces : bool
        limit : int
        is_ordered : bool
            Whether a ray's hits must come by t, then prim_id, in one part that has splits.
            Without it, hits come as they are found, each ray's on one thread.
        visitor : callable
            Called on several threads.
        status : ndarray of shape (N,), uint8
        progress : callable, optional
            Called with (steps done, steps).
        """
        del is_ordered  # they always are
        splits, hits = self.multi_hit_batch(batch, surfaces, limit, status, progress)
        cut(Found(hits, splits, None, 0), visitor)
