"""Passes: a record of the passes of a multipass machine, and a lower bound of their number."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from raystream.machines.steps.base import StepKernel
from raystream.streams import Counters, Pass


@dataclass
class Passes:
    """The passes of a query, in order.

    Attributes
    ----------
    counters : Counters
        Every pass: its kernel, active rays (``run_count``), rays in the streams
        (``record_count``), words read and written.
    optimal_count : int
        The most runs on any ray, summed over kernels (Purcell 2002, section 4.2): a lower bound,
        which a schedule may not reach.
    most_runs : dict of str to int
        For each kernel, the most runs on any ray.
    draw_count : int
        Draws of a graphics pipeline, including those that drew nothing; 0 elsewhere.
    """

    counters: Counters = field(default_factory=Counters)
    optimal_count: int = 0
    most_runs: dict[str, int] = field(default_factory=dict)
    draw_count: int = 0

    def add_bound(
        self,
        kernels: Sequence[StepKernel],
        runs: NDArray[np.uint32],
        at_once: Mapping[str, int],
    ) -> None:
        """Add to the lower bound for rays that were traced together.

        Parameters
        ----------
        kernels : sequence of StepKernel
        runs : ndarray of shape (N, 8), uint32
            Runs of each kernel on each ray.
        at_once : mapping of str to int
            Runs per ray and pass, by `StepKernel.limit`.
        """
        most = runs.max(axis=0, initial=0)
        for one, ran in zip(kernels, most.tolist(), strict=False):
            self.optimal_count += -(-ran // at_once[one.limit])
            self.most_runs[one.name] = max(self.most_runs.get(one.name, 0), ran)

    @property
    def efficiency(self) -> float:
        """SIMD efficiency: the mean share of active rays in a pass; nan without passes.

        Rays that have ended count as inactive, unless compaction removed them.
        """
        shares = [one.run_count / one.record_count for one in self]
        return float(np.mean(shares)) if shares else float("nan")

    def of(self, kernel: str) -> int:
        """Number of passes of a kernel."""
        return sum(one.kernel == kernel for one in self)

    def __len__(self) -> int:
        return self.counters.pass_count

    def __iter__(self) -> Iterator[Pass]:
        return iter(self.counters.passes)

    def __str__(self) -> str:
        return (
            f"{len(self):,} passes, at least {self.optimal_count:,}; "
            f"efficiency {self.efficiency:.1%}\n{self.counters}"
        )
