"""The rays of a multipass machine: streams, and the kernels over them."""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.machines.ray_job import RayJob
from raystream.machines.records import FOUND, NO_ROOM, RAY, WANTED, RayState, StepArguments
from raystream.machines.schedulers import Queues, Scheduler
from raystream.machines.steps.base import StepKernel, Steps
from raystream.streams import Counters, Kernel, Stream

#: Streams are compacted when at most this share of their rays is active.
_COMPACTION = 0.5


def declared_as(
    steps: Steps,
    query: StepArguments,
    number: int,
    read: Mapping[str, Stream],
    written: Mapping[str, Stream],
    constants: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """The arguments of `streams.Kernel` for a kernel of a traversal.

    Parameters
    ----------
    steps : Steps
    query : StepArguments
    number : int
        Index of the kernel.
    read, written : mapping of str to Stream
        The streams by name; those written include ``state``.
    constants : mapping of str, optional
        More constants than the traversal's.
    """
    one = steps.kernels[number]
    names = inspect.signature(one.function).parameters
    known = {"tree": steps.tree, "query": query, "kernel": np.uint64(number), **constants}
    outputs = [*(written[name] for name in one.outputs), written["state"]]
    return {
        "inputs": {name: read[name] for name in names if name in read},
        "outputs": outputs if one.outputs else outputs[0],
        "constants": {name: known[name] for name in names if name in known},
    }


def empty_rays(steps: Steps, count: int) -> dict[str, NDArray[Any]]:
    """Records of rays that wait for set-up; their rays and goals are yet to be written."""
    wanted = np.empty(count, WANTED)
    wanted["number"] = np.arange(count, dtype=np.uint32)
    return {
        "ray": np.empty(count, RAY),
        "wanted": wanted,
        "found": np.zeros(count, FOUND),
        "place": np.zeros(count, steps.place),
        "state": np.full(count, RayState.STARTING, np.uint8),
    }


class RayStreams:
    """Rays, each with a state that names the kernel it waits for.

    Parameters
    ----------
    steps : Steps
    query : StepArguments
    arrays : dict of str to ndarray
        The records of N rays: ``ray``, ``wanted``, ``found``, ``place``, ``state``, and those of
        kernels that spawn rays.
    constants : mapping of str, optional
        Of a renderer's kernels.
    spawns : bool
        Shading spawns rays, see `Queues`.
    kept : object, optional
        Kept alive: kernels read it by address.

    Attributes
    ----------
    counts : ndarray of shape (N,), uint32
        Hits of the rays that have ended.
    passes : Counter
        Passes of each kernel so far.
    on_run : callable or None
        Called with each `StepKernel` after it has run.
    """

    def __init__(
        self,
        steps: Steps,
        query: StepArguments,
        arrays: dict[str, NDArray[Any]],
        constants: Mapping[str, Any] = MappingProxyType({}),
        spawns: bool = False,
        kept: object = None,
    ) -> None:
        self._spawns, self._kept = spawns, kept
        self.passes: Counter[str] = Counter()
        self._steps = steps
        self._query = query
        self._constants = constants
        self.counts = np.zeros(len(arrays["state"]), np.uint32)
        self.on_run: Callable[[StepKernel | None], None] | None = None
        # NumPy compares arrays with an IntEnum 4 microseconds slower.
        self._waited_for = [np.uint8(one.state) for one in steps.kernels]
        self._set(arrays)

    @classmethod
    def of(cls, steps: Steps, query: StepArguments, job: RayJob) -> RayStreams:
        """The rays of a job."""
        rays, arrays = job.rays, empty_rays(steps, len(job))
        ray, wanted = arrays["ray"], arrays["wanted"]
        ray["origin"], ray["direction"] = rays.origins, rays.directions
        ray["t_min"], ray["t_max"] = rays.t_min, rays.t_max
        wanted["first"], wanted["capacity"] = job.first, job.capacity
        return cls(steps, query, arrays)

    def _set(self, arrays: dict[str, NDArray[Any]]) -> None:
        self._streams = {name: Stream(array, name=name) for name, array in arrays.items()}
        self._kernels = [
            self._kernel(number, one) for number, one in enumerate(self._steps.kernels)
        ]

    def _kernel(self, number: int, one: StepKernel) -> Kernel:
        state = self._streams["state"]
        return Kernel(
            one.function,
            **declared_as(
                self._steps, self._query, number, self._streams, self._streams, self._constants
            ),
            where=state == int(one.state),
            name=one.name,
        )

    def __len__(self) -> int:
        return len(self._streams["state"])

    @property
    def streams(self) -> Mapping[str, Stream]:
        """The streams by name; new ones after `drop_ended`."""
        return self._streams

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The records now, by the names of the streams."""
        return {name: stream.array for name, stream in self._streams.items()}

    def waiting(self) -> list[int]:
        """The number of rays that wait for each kernel."""
        states = self._streams["state"].array
        return [int(np.count_nonzero(states == state)) for state in self._waited_for]

    def _stuck(self) -> int:
        """Rays that wait for more room."""
        states = self._streams["state"].array
        return int(np.count_nonzero(states == NO_ROOM)) if self._spawns else 0

    def run(self, kernel: int, counters: Counters | None) -> int:
        """Run a kernel on the rays that wait for it; returns their number."""
        count = self._kernels[kernel].execute(counters=counters)
        self.passes[self._steps.kernels[kernel].name] += 1
        if self.on_run is not None:
            self.on_run(self._steps.kernels[kernel])
        return count

    def schedule(
        self, scheduler: Scheduler, compaction: bool = False, counters: Counters | None = None
    ) -> Iterator[tuple[int, list[int]]]:
        """Choose kernels until no ray is active; the caller must `run` each one.

        Parameters
        ----------
        scheduler : Scheduler
        compaction : bool
            Whenever half of the rays that are left have ended their search, shade and remove
            them.
        counters : Counters, optional
            Passes of compaction are added.

        Yields
        ------
        kernel : int
            Its index.
        waiting : list of int
            The number of rays that wait for each kernel.

        Raises
        ------
        ValueError
            If the scheduler chooses a kernel for which no ray waits.
        """
        kernels, spawns = self._steps.kernels, self._spawns
        shading = len(kernels) - 1
        latest: int | None = None
        waiting = self.waiting()
        while any(waiting):
            searching = sum(waiting[: shading + spawns])
            if compaction and searching + self._stuck() <= _COMPACTION * len(self):
                if waiting[shading] and not spawns:
                    self.run(shading, counters)
                self.drop_ended()
                waiting = self.waiting()
                if not searching:
                    break
            latest = scheduler.choose(Queues(kernels, waiting, latest, spawns))
            if latest not in range(len(kernels)) or not waiting[latest]:
                chosen = dict(enumerate(one.name for one in kernels)).get(latest, latest)
                raise ValueError(
                    f"scheduler: {scheduler!r} chose {chosen!r}, for which no ray waits"
                )
            yield latest, waiting
            waiting = self.waiting()

    def drop_ended(self) -> None:
        """Remove the rays that have ended; the others keep their order."""
        is_kept = self._streams["state"].array != RayState.DONE
        self._note_counts(~is_kept)
        self._set({name: stream.array[is_kept] for name, stream in self._streams.items()})

    def finish(self) -> None:
        """Record the hit counts of the rays that are left."""
        self._note_counts(self._streams["state"].array == RayState.DONE)

    def _note_counts(self, of: NDArray[np.bool_]) -> None:
        numbers = self._streams["wanted"].array["number"][of]
        self.counts[numbers] = self._streams["found"].array["count"][of]
