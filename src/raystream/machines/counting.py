"""Counting: a machine that keeps what the rays of its latest query met."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeVar, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.kernels.tally import new_tallies
from raystream.machines.counters import RayCounters
from raystream.machines.passes import Passes
from raystream.structures import Structure
from raystream.structures.batches import BatchQueries

__all__ = ["Counting", "Machine", "RecordingMachine"]

Answer = TypeVar("Answer")


class Machine(Protocol):
    """What traverses a structure.

    Attributes
    ----------
    structure : Structure
    """

    structure: Structure


@runtime_checkable
class RecordingMachine(Machine, Protocol):
    """A machine that runs passes."""

    def recording(self, passes: Passes) -> BatchQueries:
        """The same machine, which adds its passes to a record."""
        ...


class Counting:
    """Asks a machine to count as it answers queries; see `BatchQueries` for these.

    Parameters
    ----------
    machine : BatchQueries
        A structure, or a machine that traverses one.

    Attributes
    ----------
    latest : RayCounters or None
        Of the latest query that was answered.
    """

    def __init__(self, machine: BatchQueries) -> None:
        self._machine = machine
        self.latest: RayCounters | None = None

    def first_hit_batch(
        self, batch: RayBatch, status: NDArray[np.uint8], progress: Progress | None = None
    ) -> HitArrays:
        """Find the nearest hit of each ray."""
        return self._ask(
            batch,
            lambda machine, tallies: machine.first_hit_batch(batch, status, progress, tallies),
        )

    def any_hit_batch(
        self, batch: RayBatch, status: NDArray[np.uint8], progress: Progress | None = None
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way."""
        return self._ask(
            batch,
            lambda machine, tallies: machine.any_hit_batch(batch, status, progress, tallies),
        )

    def count_hits_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits of each ray, up to `limit`."""
        return self._ask(
            batch,
            lambda machine, tallies: machine.count_hits_batch(
                batch, surfaces, limit, status, progress, tallies
            ),
        )

    def multi_hit_batch(
        self,
        batch: RayBatch,
        surfaces: bool,
        limit: int,
        status: NDArray[np.uint8],
        progress: Progress | None = None,
    ) -> tuple[NDArray[np.int64], HitArrays]:
        """Find the nearest `limit` hits of each ray."""
        return self._ask(
            batch,
            lambda machine, tallies: machine.multi_hit_batch(
                batch, surfaces, limit, status, progress, tallies
            ),
        )

    def _ask(
        self, batch: RayBatch, query: Callable[[BatchQueries, NDArray[Any]], Answer]
    ) -> Answer:
        tallies = new_tallies(len(batch))
        passes: Passes | None = None
        machine = self._machine
        if isinstance(machine, RecordingMachine):
            passes = Passes()
            machine = machine.recording(passes)
        answer = query(machine, tallies)
        self.latest = RayCounters.of(tallies, batch.shape, _structure_of(machine).name, passes)
        return answer


def _structure_of(machine: BatchQueries) -> Structure:
    if isinstance(machine, Structure):
        return machine
    structure: Structure = cast("Machine", machine).structure
    return structure
