"""Record every step of rays through a structure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parallel_for, part_of
from raystream.kernels.hits import HitAddresses, HitArrays
from raystream.kernels.tally import new_tallies
from raystream.machines.counters import RayCounters
from raystream.machines.ray_block import RayBlock, blocks
from raystream.machines.records import FOUND, SHADE_HITS, StepArguments
from raystream.machines.steps import steps_of
from raystream.structures import Structure
from raystream.tracer import Tracer
from raystream_lab.walks.record_loop import search_loop, visits_of
from raystream_lab.walks.walks import Walks

#: Rays per task of a thread.
_CHUNK = 1 << 12

#: Bytes per ray for counts, without its steps.
_RAY_BYTES = 2 * 32 + 2 * 8 + 4

#: More steps than any ray takes.
_UNLIMITED = np.uint64(1 << 62)


def record(
    structure: Structure | Tracer,
    origins: Any,
    directions: Any,
    *,
    t_min: Any = 0.0,
    t_max: Any = np.inf,
    any_hit: bool = False,
    visits: bool = False,
    progress: Progress | None = None,
) -> Walks:
    """Trace rays and record which kernels of the multipass machine run on each, and how often.

    Parameters
    ----------
    structure : Structure or Tracer
        Any structure with kernels.
    origins, directions : array_like of shape S + (3,), real
    t_min, t_max : float or array_like that broadcasts to S
        Closed search interval, in direction lengths.
    any_hit : bool
        Find any hit, as shadow rays do, instead of the first.
    visits : bool
        Also record the cell or node that each step visits: 4 bytes per step.
    progress : callable, optional
        Called with (rays done, rays); each ray counts in both searches.

    Returns
    -------
    Walks

    Raises
    ------
    ValueError
        If the structure has no kernels, or its visits cannot be recorded.
    MemoryError
        If the steps do not fit into the free memory; checked before recording them.

    Notes
    -----
    The machine's own kernels run on one ray from start to end, twice, since the first search
    determines the memory needed. A kernel takes as many steps in a row as it can, or one if visits
    are recorded.
    """
    if isinstance(structure, Tracer):
        structure = structure.structure
    if visits and visits_of(structure.name) is None:
        raise ValueError(f"visits: not supported for {structure.name}; expected grid or kdtree")
    batch = RayBatch(origins, directions, t_min, t_max)
    recording = _Recording(structure, batch, any_hit)
    count = len(batch)
    recording.run(part_of(progress, 0, count, 2 * count))
    recording.allocate(visits)
    recording.run(part_of(progress, count, count, 2 * count))
    return recording.walks()


class _Recording:
    """Rays that are searched twice: to count their steps, and to record them."""

    def __init__(self, structure: Structure, batch: RayBatch, any_hit: bool) -> None:
        count = len(batch)
        check_memory(count * _RAY_BYTES, f"counts of {count:,} rays would", "record fewer rays")
        self.structure, self.batch, self.any_hit = structure, batch, any_hit
        self.steps = steps_of(structure)
        self.loop = search_loop(structure.name, self.steps)
        self.is_recording = self.has_visits = False
        self.run_splits = np.zeros(count + 1, np.int64)
        self.visit_splits = np.zeros(count + 1, np.int64)
        self.tallies, self.runs = new_tallies(count), new_tallies(count)
        self.prim_ids = np.full(count, -1, np.int32)
        self.run_kernels, self.run_lengths = np.empty(0, np.uint8), np.empty(0, np.uint32)
        self.visits = np.empty(0, np.uint32)

    def run(self, progress: Progress | None) -> None:
        """Search all rays, block by block."""
        status = np.zeros(len(self.batch), np.uint8)
        for block in blocks(self.batch, self.structure.frame, status, progress):
            self._run_block(block)

    def allocate(self, has_visits: bool) -> None:
        """Allocate memory for the steps counted by the first search."""
        np.cumsum(self.run_splits, out=self.run_splits)
        if has_visits:
            np.cumsum(self._visit_counts(), out=self.visit_splits[1:])
        run_count, visit_count = int(self.run_splits[-1]), int(self.visit_splits[-1])
        check_memory(
            5 * run_count + 4 * visit_count,
            f"{run_count:,} runs and {visit_count:,} visits of {len(self.batch):,} rays would",
            "record fewer rays at a time",
        )
        self.run_kernels = np.empty(run_count, np.uint8)
        self.run_lengths = np.empty(run_count, np.uint32)
        self.visits = np.empty(visit_count, np.uint32)
        self.is_recording, self.has_visits = True, has_visits

    def _visit_counts(self) -> NDArray[np.int64]:
        """Steps of each ray that visit a cell or node."""
        own = visits_of(self.structure.name)
        states = own.states if own else ()
        columns = [k for k, one in enumerate(self.steps.kernels) if one.state in states]
        counts: NDArray[np.int64] = self.runs[:, columns].sum(axis=1, dtype=np.int64)
        return counts

    def _run_block(self, block: RayBlock) -> None:
        rows = slice(block.rows.start, block.rows.stop + 1)
        count = block.rows.stop - block.rows.start
        hits = None if self.any_hit else HitArrays.empty(count)
        if hits is not None:
            hits.prim_id.fill(-1)
        # The first search took the counts: those of the second are ignored.
        runs = new_tallies(count) if self.is_recording else self.runs[block.rows]
        tallies = None if self.is_recording else self.tallies[block.rows]

        def search(begin: int, end: int) -> None:
            stack = np.empty(max(8, self.steps.stack_bytes), np.uint8)
            self.loop(
                begin,
                end,
                block.rays,
                self.steps.tree,
                self._query(hits, tallies, runs, stack),
                np.zeros(1, FOUND),
                np.zeros(1, self.steps.place),
                self.is_recording,
                self.has_visits,
                self.run_splits[rows],
                self.run_kernels,
                self.run_lengths,
                self.visit_splits[rows],
                self.visits,
            )

        parallel_for(search, count, _CHUNK, block.progress)
        if hits is not None and self.is_recording:
            self.prim_ids[block.rows] = hits.prim_id

    def _query(
        self,
        hits: HitArrays | None,
        tallies: NDArray[np.uint32] | None,
        runs: NDArray[np.uint32],
        stack: NDArray[np.uint8],
    ) -> StepArguments:
        """Arguments of the kernels, with one stack for one ray after another."""
        nowhere = np.uint64(0)
        return StepArguments(
            max_coordinate=np.float32(self.structure.triangles.max_coordinate),
            surfaces=False,
            shaded_hits=SHADE_HITS,
            hits=None if hits is None else HitAddresses.of(hits),
            tallies=nowhere if tallies is None else _address(tallies),
            runs=_address(runs),
            stacks=_address(stack),
            stack_bytes=nowhere,
            steps=np.uint64(1) if self.has_visits else _UNLIMITED,
            tests=_UNLIMITED,
        )

    def walks(self) -> Walks:
        """The recorded walks."""
        kernels = self.steps.kernels
        counters = RayCounters.of(self.tallies, self.batch.shape, self.structure.name, None)
        return Walks(
            structure=self.structure,
            kernels=kernels,
            shape=self.batch.shape,
            run_splits=self.run_splits,
            run_kernels=self.run_kernels,
            run_lengths=self.run_lengths,
            runs=self.runs[:, : len(kernels)],
            prim_ids=self.prim_ids,
            counters=counters,
            visit_splits=self.visit_splits if self.has_visits else None,
            visits=self.visits if self.has_visits else None,
        )


def _address(array: NDArray[Any]) -> np.uint64:
    return np.uint64(array.ctypes.data)
