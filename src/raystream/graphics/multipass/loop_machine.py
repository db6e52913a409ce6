"""Runs renderers' loops on a multipass machine, pass after pass, until no pixel has a ray left."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Kind
from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.kernels import TraversalKernels
from raystream.graphics.multipass.loop_plan import (
    loop_kernels,
    make_loop_plan,
    make_resuming_draw,
)
from raystream.graphics.multipass.loops import Batch, Work, limited
from raystream.graphics.multipass.plan import Plan, PlanInputs
from raystream.graphics.multipass.ray_loop import FragmentLoop, LoopStreams
from raystream.graphics.ray_textures import RayTextures
from raystream.graphics.streams.kernel import FragmentKernel
from raystream.graphics.structures import ShaderStructure
from raystream.jit.threads import Progress

#: The options of a search of nearest hits without counters.
_QUERY = Kind.FIRST_HIT, False


class LoopMachine(NamedTuple):
    """A machine, as its loops need it.

    Attributes
    ----------
    traversal : TraversalKernels
    shaders : ShaderStructure
        The structure's.
    rays : RayTextures
        With the structure's arrays, and the uniform of all kernels.
    max_coordinate : float32
    constants : mapping of str to float
        Values of ``override`` declarations of the traversal's kernels.
    batches : callable
        ``batches(work, kernels, streams)`` runs passes; see `multipass.loops`.
    max_passes : int
    """

    traversal: TraversalKernels
    shaders: ShaderStructure
    rays: RayTextures
    max_coordinate: np.float32
    constants: dict[str, float]
    batches: Callable[[Work, tuple[FragmentKernel, ...], LoopStreams], Iterator[Batch]]
    max_passes: int

    def plan(self, loop: FragmentLoop) -> Plan:
        """The draws of a loop."""
        opened = self.rays.opened
        inputs = PlanInputs(
            self.shaders,
            self.rays.instead(*_QUERY),
            {"QUERY": float(Kind.FIRST_HIT), "SURFACES": 0.0, **self.constants},
            self.rays.layouts(*_QUERY),
            False,
            self.rays.rewrite,
        )
        return make_loop_plan(opened, self.traversal, inputs, loop)

    def run(
        self,
        loop: FragmentLoop,
        plan: Plan,
        streams: LoopStreams,
        passes: Counter[str],
        progress: Progress | None = None,
    ) -> NDArray[np.float32]:
        """Run a loop.

        Parameters
        ----------
        loop : FragmentLoop
        plan : Plan
            The loop's.
        streams : LoopStreams
        passes : Counter
            The number of passes of each kernel is added.
        progress : callable, optional
            Called with (pixels done, pixels).

        Returns
        -------
        ndarray of shape (P, 3), float32
            The light of each pixel.

        Raises
        ------
        GraphicsError
            If there are more passes than allowed, or a search does not end.
        """
        opened, kernels = self.rays.opened, loop_kernels(self.traversal, loop)
        self.rays.write_shared_params(self.max_coordinate, streams.count, streams.shape.width)
        bind = streams.bindings(self.rays, self.rays.groups(*_QUERY), loop)
        work = Work(opened, streams.passes, plan, bind, streams.count, spawns=loop.spawns)
        passes["eye rays"] += 1
        stuck = self._run(work, kernels, streams, passes, progress)
        while stuck and loop.grow is not None:
            encoder = opened.device.create_command_encoder()
            loop.grow(encoder)
            opened.device.queue.submit([encoder.finish()])
            bind = streams.bindings(self.rays, self.rays.groups(*_QUERY), loop)
            draw = make_resuming_draw(opened)
            again = replace(work, bind=bind, count=stuck, resumes=draw)
            stuck = self._run(again, kernels, streams, passes, progress)
        if progress:
            progress(streams.count, streams.count)
        endless = int((streams.budgets() == 0).sum())
        if endless:
            raise GraphicsError(
                f"device 'graphics': {endless:,} of {streams.count:,} pixels' rays in "
                f"{self.shaders.name!r} took more than {self.shaders.budget:,} steps and tests "
                f"({opened.adapter})"
            )
        return np.ascontiguousarray(streams.light(), np.float32)

    def _run(
        self,
        work: Work,
        kernels: tuple[FragmentKernel, ...],
        streams: LoopStreams,
        passes: Counter[str],
        progress: Progress | None,
    ) -> int:
        """Passes until no ray is active; returns how many pixels wait for more room."""
        stuck = 0
        for batch in limited(self.batches(work, kernels, streams), self.max_passes):
            stuck = batch.stuck_count
            passes.update(kernels[number].name for number, _ in batch.passes)
            if progress:
                progress(max(streams.count - batch.active_count, 0), streams.count)
        return stuck
