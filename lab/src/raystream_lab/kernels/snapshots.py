"""First hits on the multipass machine pass by pass, with snapshots of rays in mid-search."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.kernels.hits import HitAddresses, HitArrays
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import SceneFrame
from raystream.machines.ray_block import blocks
from raystream.machines.ray_job import RayJob
from raystream.machines.ray_streams import RayStreams, declared_as
from raystream.machines.schedulers import make_scheduler
from raystream.machines.steps import Steps, steps_of
from raystream.streams import Counters, Kernel, Stream
from raystream.structures import Structure
from raystream_lab.kernels.record_code import first_hit_query


def in_local_frame(structure: Structure) -> Structure:
    """A copy that traces rays of its own frame, one by one."""
    local = copy.copy(structure)
    local.frame, local.many_ray_kernels = SceneFrame.identity(structure.triangles), {}
    return local


def local_rays(structure: Structure, origins: Any, directions: Any) -> LocalRays:
    """Rays in the frame of a structure's triangles.

    Parameters
    ----------
    structure : Structure
    origins, directions : array_like of shape S + (3,), real
        World space; t from 0 to infinity.

    Returns
    -------
    LocalRays
        The valid rays.
    """
    batch = RayBatch(origins, directions, 0.0, np.inf)
    status = np.zeros(len(batch), np.uint8)
    parts = [block.rays for block in blocks(batch, structure.frame, status, None)]
    return LocalRays(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


class Search:
    """A first-hit search on the multipass machine, run pass by pass.

    It has the machine's streams, kernels and schedulers, without counters.

    Parameters
    ----------
    structure : Structure
    rays : LocalRays
    scheduler : str
        See `machines.schedulers`.
    compaction : bool
        Whether to drop finished rays from the streams.
    steps : Steps, optional
        Other kernels than the structure's own, such as those of `as_published`.

    Attributes
    ----------
    steps : Steps
    streams : RayStreams
    hits : HitArrays
        Row i belongs to ray i; a miss has t = inf.
    """

    def __init__(
        self,
        structure: Structure,
        rays: LocalRays,
        scheduler: str = "threshold",
        compaction: bool = False,
        steps: Steps | None = None,
    ) -> None:
        count = len(rays.t_min)
        self.steps = steps_of(structure) if steps is None else steps
        self.hits = HitArrays.empty(count)
        self.hits.t.fill(np.inf)
        self.hits.prim_id.fill(-1)
        self.stacks = np.zeros((count, self.steps.stack_bytes), np.uint8)
        self._max_coordinate = float(structure.triangles.max_coordinate)
        self._scheduler = make_scheduler(scheduler)
        self._compaction = compaction
        rows, one = np.arange(count, dtype=np.uint64), np.ones(count, np.uint64)
        query = query_of(self._max_coordinate, self.hits, self.stacks)
        self.streams = RayStreams.of(self.steps, query, RayJob(rays, rows, one, None))

    def schedule(self) -> Iterator[tuple[int, list[int]]]:
        """Yield kernels until no ray is active; see `RayStreams.schedule`."""
        return self.streams.schedule(self._scheduler, self._compaction)

    def run(self, counters: Counters | None = None) -> int:
        """Run to the end; returns the number of passes."""
        passes = 0
        for kernel, _ in self.schedule():
            self.streams.run(kernel, counters)
            passes += 1
        return passes

    def snapshot(self, kernel: int) -> Snapshot:
        """Copy the rays that wait for a kernel."""
        arrays = {name: stream.array for name, stream in self.streams.streams.items()}
        chosen = arrays["state"] == np.uint8(self.steps.kernels[kernel].state)
        return Snapshot(
            self.steps,
            kernel,
            {name: array[chosen] for name, array in arrays.items()},
            self.hits.copy_of(slice(None)),
            self.stacks.copy(),
            self._max_coordinate,
        )


class Snapshot(NamedTuple):
    """Rays that wait for a kernel in mid-search.

    Attributes
    ----------
    steps : Steps
    number : int
        Index of the kernel.
    arrays : dict of str to ndarray
        The streams' records of these rays.
    hits : HitArrays
        Hits so far of all rays of the search.
    stacks : ndarray of shape (N, B), uint8
        Of all rays.
    max_coordinate : float
        See `kernels.ray.prepare_ray`.
    """

    steps: Steps
    number: int
    arrays: dict[str, NDArray[Any]]
    hits: HitArrays
    stacks: NDArray[np.uint8]
    max_coordinate: float

    def __len__(self) -> int:
        return len(self.arrays["state"])

    def kernel(self, steps: Steps | None = None) -> tuple[Kernel, dict[str, Stream]]:
        """The kernel over these rays; its outputs are other streams than its inputs.

        Parameters
        ----------
        steps : Steps, optional
            Steps of the same kind with another function for the kernel.

        Returns
        -------
        kernel : Kernel
            Runs on all rays, each time with the same result. It also writes to `hits`, so keep the
            snapshot alive.
        written : dict of str to Stream
            Its outputs, by the name of the original stream.
        """
        steps = self.steps if steps is None else steps
        read = {name: Stream(array, name=name) for name, array in self.arrays.items()}
        written = {name: Stream(array, name=name) for name, array in self.arrays.items()}
        query = query_of(self.max_coordinate, self.hits, self.stacks)
        one = steps.kernels[self.number]
        given = declared_as(steps, query, self.number, read, written)
        return Kernel(one.function, name=one.name, **given), written


def busiest(search: Search, kernels: list[str], pass_limit: int | None = None) -> dict[str, int]:
    """Run a search to find the pass of each kernel in which most rays wait for it.

    Parameters
    ----------
    search : Search
        Not yet run.
    kernels : list of str
        Kernels of interest.
    pass_limit : int, optional
        Stop after this many passes.

    Returns
    -------
    dict of str to int
        Index of the pass, without kernels that did not run.
    """
    best: dict[str, tuple[int, int]] = {}
    for number, (kernel, waiting) in enumerate(search.schedule()):
        name = search.steps.kernels[kernel].name
        if name in kernels and waiting[kernel] > best.get(name, (0, 0))[0]:
            best[name] = waiting[kernel], number
        search.streams.run(kernel, None)
        if pass_limit is not None and number + 1 >= pass_limit:
            break
    return {name: number for name, (_, number) in best.items()}


def snapshots(search: Search, passes: dict[str, int]) -> dict[str, Snapshot]:
    """Run a search and copy the rays of given passes.

    Parameters
    ----------
    search : Search
        Not yet run, with the same rays as the search that found the passes.
    passes : dict of str to int
        From `busiest`.
    """
    wanted = {number: name for name, number in passes.items()}
    taken: dict[str, Snapshot] = {}
    for number, (kernel, _) in enumerate(search.schedule()):
        if number in wanted:
            taken[wanted[number]] = search.snapshot(kernel)
        if len(taken) == len(wanted):
            break
        search.streams.run(kernel, None)
    return taken


def query_of(max_coordinate: float, hits: HitArrays, stacks: NDArray[np.uint8]) -> Any:
    """Kernel arguments for first hits written to arrays, which must stay alive."""
    addresses = HitAddresses(*(np.uint64(column.ctypes.data) for column in hits))
    return first_hit_query(max_coordinate, addresses, stacks.ctypes.data, stacks.shape[1])
