"""Recorded walks: the kernel runs of each ray."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.machines.counters import RayCounters
from raystream.machines.steps.base import StepKernel
from raystream.structures import Structure
from raystream_lab.walks.distinct_walks import DistinctWalks, distinct_walks


class Run(NamedTuple):
    """Consecutive steps of one kernel on a ray.

    Attributes
    ----------
    kernel : str
    length : int
        Number of steps, one pass each unless a pass takes several.
    """

    kernel: str
    length: int


@dataclass(frozen=True)
class Walks:
    """The runs of the multipass machine's kernels on each ray, in order.

    Attributes
    ----------
    structure : Structure
        The structure that visits refer to.
    kernels : tuple of StepKernel
        Of the structure: set-up first, shading last.
    shape : tuple of int
        Shape S of the N rays.
    run_splits : ndarray of shape (N + 1,), int64
        Ray i has runs run_splits[i] to run_splits[i + 1].
    run_kernels : ndarray of shape (M,), uint8
        Index into `kernels`; consecutive runs of a ray differ.
    run_lengths : ndarray of shape (M,), uint32
        Number of steps.
    runs : ndarray of shape (N, K), uint32
        Steps of each kernel on each ray.
    prim_ids : ndarray of shape (N,), int32
        First hits; -1 for a miss, and always for any hits.
    counters : RayCounters
        Counters of each ray.
    visit_splits : ndarray of shape (N + 1,), int64, or None
        Ray i made the visits visit_splits[i] to visit_splits[i + 1].
    visits : ndarray of shape (V,), uint32, or None
        In a grid, the cell of each step of `traverse`: cell (i, j, k) is i + nx (j + ny k),
        followed by inner cells, as in `FineArrays.lists`. In a kd-tree, the node at which each step
        of `down`, `leaf` and `up` began. None if not recorded.
    """

    structure: Structure
    kernels: tuple[StepKernel, ...]
    shape: tuple[int, ...]
    run_splits: NDArray[np.int64]
    run_kernels: NDArray[np.uint8]
    run_lengths: NDArray[np.uint32]
    runs: NDArray[np.uint32]
    prim_ids: NDArray[np.int32]
    counters: RayCounters
    visit_splits: NDArray[np.int64] | None = None
    visits: NDArray[np.uint32] | None = None

    def __len__(self) -> int:
        return len(self.run_splits) - 1

    @property
    def names(self) -> tuple[str, ...]:
        """The kernels' names."""
        return tuple(one.name for one in self.kernels)

    @cached_property
    def distinct(self) -> DistinctWalks:
        """The distinct walks, and the number of rays of each."""
        return distinct_walks(self.run_splits, self.run_kernels, self.run_lengths)

    @cached_property
    def most_runs(self) -> tuple[int, ...]:
        """Maximum steps of each kernel on any ray."""
        return tuple(self.runs.max(axis=0, initial=0).tolist())

    def runs_of(self, ray: int) -> Iterator[Run]:
        """The runs of one ray, in order."""
        rows = slice(*self.run_splits[ray : ray + 2].tolist())
        names = self.names
        for k, n in zip(self.run_kernels[rows], self.run_lengths[rows], strict=True):
            yield Run(names[k], int(n))

    def visits_of(self, ray: int) -> NDArray[np.uint32]:
        """The cells or nodes that one ray visited.

        Raises
        ------
        ValueError
            If visits were not recorded.
        """
        if self.visits is None or self.visit_splits is None:
            raise ValueError("visits: not recorded; record with visits=True")
        return self.visits[slice(*self.visit_splits[ray : ray + 2].tolist())]
