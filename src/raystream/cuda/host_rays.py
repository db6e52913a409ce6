"""Rays in host memory: traced in parts that two streams copy and trace in turn."""

from __future__ import annotations

import itertools
from collections import deque
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.cuda.launch import DeviceScene, RayLauncher, Steps, resume
from raystream.cuda.queries import QUERIES
from raystream.cuda.rays import place_rays, split_rows
from raystream.cuda.staging import StagedScope, StagingStream, StagingStreams
from raystream.jit.cuda import DeviceArray
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink


class _Part(NamedTuple):
    """A part that has been launched as far as it could be without waiting."""

    rows: slice
    staging: StagingStream
    steps: Steps[None]
    copies: list[NDArray[Any]] | None


def trace_from_host(
    scene: DeviceScene,
    staging_streams: StagingStreams,
    rays_at_once: int,
    query: Query,
    batch: RayBatch,
    sink: Sink,
    progress: Progress | None = None,
) -> None:
    """Trace a batch in host memory: while one part is traced, another is copied.

    Parameters
    ----------
    scene : DeviceScene
    staging_streams : StagingStreams
    rays_at_once : int
        Most rays on the device together.
    query : Query
    batch : RayBatch
    sink : Sink
        For `Kind.MULTI_HIT` with `splits` and `hits`, if the hits have been counted, or with a
        `visitor`.
    progress : callable, optional
        Called with (rays done, rays) after each part.

    Raises
    ------
    CudaError
        If there is no memory, or the device fails.
    """
    splits = getattr(sink, "splits", None)
    with staging_streams.taken() as turns:
        launched: deque[_Part] = deque()
        most = max(rays_at_once // len(turns), 1)
        parts = split_rows(slice(0, len(batch)), most, splits)
        with ExitStack() as begun:  # after an error, their memory is freed in their streams' order
            for rows, staging in zip(parts, itertools.cycle(turns), strict=False):
                if len(launched) == len(turns):
                    _finish(launched.popleft(), batch, progress)
                staging.begin()
                steps = _trace_part(scene, StagedScope(staging), query, batch, rows, sink)
                begun.callback(steps.close)
                copies = _download(staging, resume(steps, None))
                launched.append(_Part(rows, staging, steps, copies))
            while launched:
                _finish(launched.popleft(), batch, progress)


def _trace_part(
    scene: DeviceScene, scope: StagedScope, query: Query, batch: RayBatch, rows: slice, sink: Sink
) -> Steps[None]:
    """Copy some rays to the device, trace them, and copy the answers to the sink."""
    tallies = splits = None
    if sink.tallies is not None:
        shape = rows.stop - rows.start, sink.tallies.shape[1]
        tallies = scope.cleared("tallies", shape, np.uint32)
    if hasattr(sink, "splits"):
        splits = sink.splits[rows.start : rows.stop + 1]
    masks = batch.masks if batch.masks is None or len(batch.masks) == 1 else batch.masks[rows]
    placed = place_rays(batch, rows, scope.placed).with_masks(scene.masks.place(scope, masks))
    rays = RayLauncher(scene, scope, placed, rows.start, tallies)
    payload = None if sink.records is None else sink.records[rows]
    chosen = query.on_hit
    if getattr(chosen, "skipped", None) is not None:
        query = query._replace(on_hit=chosen._replace(skipped=chosen.skipped[rows]))
    task = QUERIES[query.kind](query, rays, payload=payload, splits=splits)
    yield from task.launch()
    counters = () if tallies is None else (tallies,)
    copies = yield (*counters, *task.outputs)
    if sink.tallies is not None:
        sink.tallies[rows] += copies.pop(0)
    task.store(copies, sink, rows)


def _download(
    staging: StagingStream, arrays: tuple[DeviceArray, ...] | None
) -> list[NDArray[Any]] | None:
    return None if arrays is None else [staging.download(one) for one in arrays]


def _finish(part: _Part, batch: RayBatch, progress: Progress | None) -> None:
    """Wait for a part, and launch what depends on it, until its answers are in the sink."""
    copies: list[NDArray[Any]] | None = part.copies
    while copies is not None:
        part.staging.finish()
        copies = _download(part.staging, resume(part.steps, copies))
    if progress:
        progress(part.rows.stop, len(batch))
