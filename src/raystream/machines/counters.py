"""RayCounters: the steps and tests of the rays of a query."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.kernels.tally import COLUMNS
from raystream.machines.backend import Backend
from raystream.machines.passes import Passes
from raystream.structures import STRUCTURES


@dataclass(frozen=True)
class RayCounters:
    """Steps and tests of each ray of a query; arrays have the rays' shape S, uint32.

    Attributes
    ----------
    steps : ndarray
        Traversal steps: cells visited in a grid; splits descended in a kd-tree (Foley's Down);
        inner nodes whose boxes were tested in a BVH; sectors of a graph. Purcell's v.
    leaves : ndarray
        Lists of triangles visited: cells that are not empty, or leaves.
    tests : ndarray
        Triangles tested. Purcell's t.
    restarts : ndarray
        Restarts of a kd-tree's traversal at the root.
    backtracks : ndarray
        Backtracks of a kd-tree's traversal.
    backtrack_steps : ndarray
        Steps to a parent (Foley's Up).
    shadings : ndarray
        Hits shaded. Purcell's s.
    link_nodes : ndarray
        Planes between sectors of a graph that were tested.
    structure : str
        The structure's name.
    passes : Passes or None
        The passes of a multipass machine.

    Notes
    -----
    `Tracer.multi_hit` counts hits before it keeps them; its counters include both searches.
    """

    steps: NDArray[np.uint32]
    leaves: NDArray[np.uint32]
    tests: NDArray[np.uint32]
    restarts: NDArray[np.uint32]
    backtracks: NDArray[np.uint32]
    backtrack_steps: NDArray[np.uint32]
    shadings: NDArray[np.uint32]
    link_nodes: NDArray[np.uint32]
    structure: str
    passes: Passes | None = None

    @classmethod
    def of(
        cls,
        tallies: NDArray[np.uint32],
        shape: tuple[int, ...],
        structure: str,
        passes: Passes | None,
    ) -> RayCounters:
        """The counters in tallies, of shape (N, 8)."""
        columns = {name: tallies[:, k].reshape(shape) for k, name in enumerate(COLUMNS)}
        return cls(**columns, structure=structure, passes=passes)

    @property
    def cells(self) -> NDArray[np.uint32]:
        """Cells of space visited: cells of a grid, sectors, or leaves of a tree."""
        return getattr(self, STRUCTURES[self.structure].cell_counter)

    @property
    def all_steps(self) -> NDArray[np.uint32]:
        """Steps down, and steps back up."""
        return self.steps + self.backtrack_steps

    @property
    def total(self) -> MappingProxyType[str, int]:
        """Sums over all rays, by name."""
        sums = {name: int(getattr(self, name).sum(dtype=np.int64)) for name in COLUMNS}
        return MappingProxyType(sums)

    def __str__(self) -> str:
        count = max(self.steps.size, 1)
        lines = [f"{'':16} {'total':>14} {'per ray':>10} {'most':>10}"]
        for name, total in self.total.items():
            most = int(getattr(self, name).max(initial=0))
            lines.append(f"{name:16} {total:14,} {total / count:10.2f} {most:10,}")
        return "\n".join([*lines, *([str(self.passes)] if self.passes else [])])


def answer_counting(
    backend: Backend, query: Query, rays: RayBatch, progress: Progress | None = None
) -> tuple[Sink, RayCounters]:
    """Answer a query with counters.

    Parameters
    ----------
    backend : Backend
        One that runs passes also records them.
    query : Query
        Without a filter.
    rays : RayBatch
    progress : callable, optional
        Called with (steps done, steps).
    """
    passes = None
    if backend.capabilities.passes:
        passes = Passes()
        backend = backend.recording(passes)
    sink = backend.answer(query._replace(counters=True), rays, progress)
    assert sink.tallies is not None
    return sink, RayCounters.of(sink.tallies, rays.shape, backend.structure.name, passes)
