"""LocalFrameBackend: base of backends that trace blocks of rays in the scene's local frame."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.kernels.local_frame import LocalRays
from raystream.machines.backend import Backend
from raystream.machines.ray_block import RayBlock, blocks


class LocalFrameBackend(Backend):
    """Transforms rays to the local frame, a block at a time, and distances back; see `ray_block`.

    All hits are counted before they are written, to allocate memory for them: counters include
    both searches.

    Attributes
    ----------
    ray_block : callable
        Makes a block of rays; called as `RayBlock` is.
    """

    ray_block: Callable[..., RayBlock] = RayBlock

    @abstractmethod
    def run_local(
        self, query: Query, rays: LocalRays, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query of local rays.

        Parameters
        ----------
        query : Query
        rays : LocalRays
        sink : Sink
            Of these rays. Of `Kind.MULTI_HIT` with `splits` and `hits`: the nearest
            splits[i + 1] - splits[i] hits of each ray i are written, by t, then prim_id; it
            must have that many.
        progress : callable, optional
            Called with (rays done, rays).
        """

    def run(
        self, query: Query, rays: RayBatch, sink: Sink, progress: Progress | None = None
    ) -> None:
        """Run a query; see `Backend.run`."""

        def trace(sink: Sink, progress: Progress | None) -> None:
            for block in blocks(rays, self.structure.frame, sink.status, progress, self.ray_block):
                part = sink.part(block.rows)
                self.run_local(query, block.rays, part, block.progress)
                if query.kind is Kind.FIRST_HIT:
                    block.to_world(part.hits.t, np.arange(len(part.hits.t) + 1))
                elif query.kind is Kind.MULTI_HIT:
                    block.to_world(part.hits.t, part.splits)

        if query.kind is Kind.MULTI_HIT:
            self.count_then_fill(query, rays, sink, progress, trace)
        else:
            trace(sink, progress)
