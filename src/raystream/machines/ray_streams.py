"""The rays of a query on a multipass machine: their streams, and the kernels over these."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.machines.records import FOUND, RAY, WANTED, Query, RayState
from raystream.machines.steps.base import StepKernel, Steps
from raystream.machines.task import Task
from raystream.streams import Counters, Kernel, Stream

__all__ = ["RayStreams"]


class RayStreams:
    """Rays, each in the state that says which kernel runs on it next.

    Parameters
    ----------
    steps : Steps
    query : Query
    task : Task

    Attributes
    ----------
    counts : ndarray of shape (N,), uint32
        Hits of the rays that have ended.
    """

    def __init__(self, steps: Steps, query: Query, task: Task) -> None:
        count, rays = len(task), task.rays
        self._steps = steps
        self._query = query
        self.counts = np.zeros(count, np.uint32)
        # Comparing an array with an IntEnum takes NumPy 4 microseconds longer.
        self._waited_for = [np.uint8(one.state) for one in steps.kernels]
        ray, wanted = np.empty(count, RAY), np.empty(count, WANTED)
        ray["origin"], ray["direction"] = rays.origins, rays.directions
        ray["t_min"], ray["t_max"] = rays.t_min, rays.t_max
        wanted["first"], wanted["capacity"] = task.first, task.capacity
        wanted["number"] = np.arange(count, dtype=np.uint32)
        self._set(
            {
                "ray": ray,
                "wanted": wanted,
                "found": np.zeros(count, FOUND),
                "place": np.zeros(count, steps.place),
                "state": np.full(count, RayState.STARTING, np.uint8),
            }
        )

    def _set(self, arrays: dict[str, NDArray[Any]]) -> None:
        self._streams = {name: Stream(array, name=name) for name, array in arrays.items()}
        self._kernels = [
            self._kernel(number, one) for number, one in enumerate(self._steps.kernels)
        ]

    def _kernel(self, number: int, one: StepKernel) -> Kernel:
        names = inspect.signature(one.function).parameters
        known = {
            "tree": self._steps.tree,
            "query": self._query,
            "kernel": np.uint64(number),
        }
        state = self._streams["state"]
        written = [self._streams[name] for name in one.outputs]
        return Kernel(
            one.function,
            inputs={name: self._streams[name] for name in names if name in self._streams},
            outputs=[*written, state] if written else state,
            constants={name: known[name] for name in names if name in known},
            where=state == int(one.state),
            name=one.name,
        )

    def __len__(self) -> int:
        return len(self._streams["state"])

    def waiting(self) -> list[int]:
        """How many rays wait for each kernel."""
        states = self._streams["state"].array
        return [int(np.count_nonzero(states == state)) for state in self._waited_for]

    def run(self, kernel: int, counters: Counters | None) -> int:
        """Run a kernel on the rays that wait for it; returns how many there were."""
        return self._kernels[kernel].execute(counters=counters)

    def drop_ended(self) -> None:
        """Keep the rays that have not ended, in their order."""
        is_kept = self._streams["state"].array != RayState.DONE
        self._note_counts(~is_kept)
        self._set({name: stream.array[is_kept] for name, stream in self._streams.items()})

    def finish(self) -> NDArray[np.bool_]:
        """Note the hits of all rays that are left; returns which rays overflowed."""
        states = self._streams["state"].array
        self._note_counts(states == RayState.DONE)
        has_overflown = np.zeros(len(self.counts), np.bool_)
        overflown = states == RayState.OVERFLOWN
        has_overflown[self._streams["wanted"].array["number"][overflown]] = True
        return has_overflown

    def _note_counts(self, of: NDArray[np.bool_]) -> None:
        numbers = self._streams["wanted"].array["number"][of]
        self.counts[numbers] = self._streams["found"].array["count"][of]
