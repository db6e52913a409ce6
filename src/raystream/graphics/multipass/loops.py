"""Loops over passes, until no ray is active."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.multipass.device_scheduler import DeviceScheduler
from raystream.graphics.multipass.plan import Plan
from raystream.graphics.streams.passes import Bindings, Draw, StreamPasses
from raystream.machines.records import RayState
from raystream.machines.schedulers import Queues, Scheduler
from raystream.machines.steps.base import StepKernel

#: Passes that are encoded before the host reads the counts: at first, and at most.
_FIRST_PASSES = 8
MOST_PASSES = 64


@dataclass(frozen=True)
class Work:
    """Rays, and the draws of their kernels.

    Attributes
    ----------
    opened : OpenDevice
    streams : StreamPasses
    plan : Plan
    bind : callable
        See `streams.passes.Bindings`.
    count : int
        Number of rays.
    prepare : callable
        Called with the kernel before each pass that the host chooses.
    resumes : Draw, optional
        Moves `count` rays to the last kernel, where an earlier run has left them; else all begin
        with the first.
    spawns : bool
        Whether shading spawns rays, see `machines.schedulers.Queues`.
    """

    opened: OpenDevice
    streams: StreamPasses
    plan: Plan
    bind: Bindings
    count: int
    prepare: Callable[[StepKernel], None] = lambda _kernel: None
    resumes: Draw | None = None
    spawns: bool = False

    def begin(self, encoder: Any, queries: Any) -> None:
        """Encode what comes before the first pass; query 0 counts the rays."""
        if self.resumes is None:
            self.streams.begin(encoder, self.plan.begin, self.bind, queries)
        else:
            self.streams.move(encoder, self.resumes, self.bind, queries)


@dataclass(frozen=True)
class Batch:
    """Passes that have run.

    Attributes
    ----------
    passes : list of (int, int)
        The number of a kernel, and the rays that it ran on.
    active_count : int
        Active rays before the last of them.
    draw_count : int
        Encoded draws, many of which may have drawn nothing.
    stuck_count : int
        Rays that wait for more room, see `RayState.NO_ROOM`.
    """

    passes: list[tuple[int, int]]
    active_count: int
    draw_count: int
    stuck_count: int = 0


def limited(batches: Iterator[Batch], max_passes: int) -> Iterator[Batch]:
    """The same batches; GraphicsError behind one with which there are more passes than allowed."""
    count = 0
    for batch in batches:
        yield batch
        count += len(batch.passes)
        if count > max_passes:
            raise GraphicsError(
                f"multipass: {batch.active_count:,} rays are still active after {count:,} passes; "
                f"max_passes is {max_passes:,}"
            )


def run_on_device(
    work: Work, device_scheduler: DeviceScheduler, inner: Sequence[int]
) -> Iterator[Batch]:
    """Let the device choose kernels; the host only tests at intervals whether rays are left.

    Parameters
    ----------
    work : Work
    device_scheduler : DeviceScheduler
    inner : sequence of int
        Kernels that run many times. The others, which run once, are encoded only in the first
        and the last pass of each batch.
    """
    kernels = range(1 + max(draw.kernel for group in work.plan.kernels for draw in group))
    device, plan = work.opened.device, work.plan
    inner_plan, length = plan.part(inner), _FIRST_PASSES
    encoder = device.create_command_encoder()
    work.begin(encoder, None)
    draw_count = len(plan.begin)
    while True:
        device_scheduler.clear_record(encoder)
        for number in range(length):
            is_edge = number in (0, length - 1)
            chosen = plan if is_edge else inner_plan
            draw_count += chosen.draw_count
            device_scheduler.encode(encoder, kernels if is_edge else inner)
            work.streams.run(
                encoder,
                chosen.kernels,
                chosen.commits,
                chosen.classifies,
                work.bind,
                device_scheduler.arguments,
            )
        device.queue.submit([encoder.finish()])
        decided = device_scheduler.read(length)
        yield Batch(decided.passes, decided.active_count, draw_count, decided.stuck_count)
        if decided.active_count == 0:
            return
        draw_count = 0
        length = min(2 * length, MOST_PASSES)
        encoder = device.create_command_encoder()


class _Counts:
    """Occlusion queries and their results."""

    def __init__(self, opened: OpenDevice, capacity: int) -> None:
        import wgpu

        self._opened = opened
        self.queries = opened.device.create_query_set(type="occlusion", count=capacity)
        self._answers = opened.device.create_buffer(
            size=8 * capacity, usage=wgpu.BufferUsage.QUERY_RESOLVE | wgpu.BufferUsage.COPY_SRC
        )

    def read(self, encoder: Any, count: int) -> list[int]:
        """Submit, wait, and return the number of fragments that each query counted."""
        encoder.resolve_query_set(self.queries, 0, count, self._answers, 0)
        queue = self._opened.device.queue
        queue.submit([encoder.finish()])
        memory = queue.read_buffer(self._answers, 0, 8 * count)
        return np.frombuffer(memory, np.uint64).tolist()


def run_by_queries(
    work: Work, scheduler: Scheduler, kernels: Sequence[StepKernel]
) -> Iterator[Batch]:
    """Let the host choose kernels, by occlusion queries that count the rays that change state.

    As Purcell 2002, section 3.2, and Christen 2005 did: the host waits for each pass.

    Raises
    ------
    GraphicsError
        If the adapter's counts are not exact: WebGPU only guarantees whether they are 0.
    """
    device, plan = work.opened.device, work.plan
    counts = _Counts(work.opened, max(1, len(plan.classifies)))
    encoder = device.create_command_encoder()
    work.begin(encoder, counts.queries)
    (begun,) = counts.read(encoder, 1)
    _check(work, begun == work.count, f"{begun:,} for {work.count:,} fragments")
    number_of = {int(one.state): number for number, one in enumerate(kernels)}
    waiting = [0] * len(kernels)
    waiting[0 if work.resumes is None else -1] = begun
    stuck_count = 0
    latest: int | None = None
    draw_count = len(plan.begin)
    parts = [plan.part([number]) for number in range(len(kernels))]
    while any(waiting):
        latest = scheduler.choose(Queues(kernels, tuple(waiting), latest, work.spawns))
        part = parts[latest]
        work.prepare(kernels[latest])
        encoder = device.create_command_encoder()
        work.streams.run(
            encoder,
            part.kernels,
            part.commits,
            part.classifies,
            work.bind,
            queries=counts.queries,
        )
        active, active_count = waiting[latest], sum(waiting)
        moved = counts.read(encoder, len(part.classifies))
        waiting[latest] -= sum(moved)
        _check(work, waiting[latest] >= 0, f"{sum(moved):,} of {active:,} rays moved")
        for state, count in zip(part.next_states, moved, strict=True):
            if state in number_of:
                waiting[number_of[state]] += count
            elif state == RayState.NO_ROOM:
                stuck_count += count
        yield Batch([(latest, active)], active_count, draw_count + part.draw_count, stuck_count)
        draw_count = 0


def _check(work: Work, is_exact: bool, what: str) -> None:
    if not is_exact:
        raise GraphicsError(
            f"multipass: {work.opened.adapter} counts fragments inexactly in occlusion queries "
            f"({what}); use loop='device'"
        )
