"""RayStreams: the rays of a query in GPU memory, between passes."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.multipass.control import Rules, begin_control
from raystream.cuda.multipass.kernels.choose import DECIDE, DECIDE_IN_LOOP
from raystream.cuda.multipass.kernels.rays import (
    BEGIN,
    CHUNK,
    COUNT_KEPT,
    KEEP,
    RayStreamAddresses,
    Wanted,
)
from raystream.cuda.multipass.passes import STREAMS, columns_of, pass_of
from raystream.cuda.multipass.query_parts import QueryPart
from raystream.cuda.soa import capacity_of
from raystream.jit.constants import NULL
from raystream.jit.cuda import DeviceLoop, Gpu, Launch
from raystream.jit.cuda.scan import Scan
from raystream.kernels.hits import HitAddresses
from raystream.kernels.tally import new_tallies
from raystream.machines.records import RayState, StepArguments
from raystream.machines.steps.base import StepKernel, Steps

__all__ = ["HitGoal", "RayStreams", "ray_bytes"]


class HitGoal(NamedTuple):
    """The hits to be found for each ray.

    Attributes
    ----------
    surfaces, shaded_hits
        See `machines.records.StepArguments`.
    wanted : Wanted
    rows : ndarray of uint32, or None
        Indices of the rays that want hits; None if all do.
    hits : HitAddresses or None
        Addresses to write hits to; None if they are only counted.
    """

    surfaces: bool
    shaded_hits: np.uint64
    wanted: Wanted
    rows: NDArray[np.uint32] | None = None
    hits: HitAddresses | None = None


def ray_bytes(steps: Steps) -> int:
    """Bytes of device memory per ray, with counters but without hits."""
    return sum(one.byte_count for one in columns_of(steps).values()) + steps.stack_bytes + 96


class RayStreams:
    """Rays on a device, each in a state that determines the kernel that runs on it next.

    Parameters
    ----------
    gpu : Gpu
    steps : Steps
        With addresses on the device.
    part : QueryPart
        The rays.
    goal : HitGoal
    limits : (int, int)
        Maximum number of steps, and of triangles tested, in a pass.
    max_coordinate : float32
        See `StepArguments`.

    Attributes
    ----------
    length : int
        Rays per launch of a pass.

    Raises
    ------
    CudaError
        If device memory runs out.
    """

    def __init__(
        self,
        gpu: Gpu,
        steps: Steps,
        part: QueryPart,
        goal: HitGoal,
        limits: tuple[int, int],
        max_coordinate: np.float32,
    ) -> None:
        self._gpu, self._steps, self._goal = gpu, steps, goal
        count = part.count
        self._count = count
        self._capacity = np.uint64(capacity_of(count))
        self._columns = columns_of(steps)
        self._streams = {
            name: columns.empty(gpu, f"stream {name!r}", count)
            for name, columns in self._columns.items()
        }
        # Rays that want no hits have ended.
        self._state = gpu.upload("states", np.full(count, RayState.DONE, np.uint8))
        self._world = gpu.empty("factors", 2 * int(self._capacity), np.float64)
        self._runs = None
        if part.tallies is not None:
            self._runs = gpu.upload("runs", new_tallies(count))
        self._stacks = gpu.empty("stacks", count * steps.stack_bytes, np.uint8)
        self._rows = None if goal.rows is None else gpu.upload("rows", goal.rows)
        self.length = count if goal.rows is None else len(goal.rows)
        self._query = StepArguments(
            max_coordinate,
            bool(goal.surfaces),
            goal.shaded_hits,
            goal.hits,
            NULL if part.tallies is None else part.tallies,
            NULL if self._runs is None else self._runs.address,
            self._stacks.address,
            np.uint64(steps.stack_bytes),
            *map(np.uint64, limits),
        )
        self._control = gpu.upload("control", begin_control(steps.kernels, self.length))
        self._begin(part)

    @property
    def addresses(self) -> RayStreamAddresses:
        """The streams, for kernels."""
        streams = (self._streams[name].address for name in ("ray", "wanted", "found"))
        rows = NULL if self._rows is None else self._rows.address
        own = self._state.address, self._world.address
        return RayStreamAddresses._make((rows, self._capacity, *streams, *own))

    @property
    def kernels(self) -> tuple[StepKernel, ...]:
        """The kernels of the traversal."""
        return self._steps.kernels

    def prepared(self, rules: Rules) -> list[Callable[[], None]]:
        """The launches of a pass: choose a kernel, then run it if any ray waits."""
        choose = DECIDE.prepared(self._gpu, 1, (self._control.address, rules))
        return [choose, self._pass.kernel.prepared(self._gpu, *self._pass[1:])]

    def loop(self, rules: Rules) -> DeviceLoop:
        """A loop of passes until no ray waits or a limit is reached; see `control.write_limits`."""

        def launches(condition: np.uint64) -> list[Launch]:
            arguments = self._control.address, rules, condition
            return [Launch(DECIDE_IN_LOOP, 1, arguments), self._pass]

        return DeviceLoop(self._gpu, launches)

    @property
    def _pass(self) -> Launch:
        streams, own = (self._streams[name].address for name in STREAMS), self.addresses
        first = self._control.address, own.rows, own.capacity
        arguments = *first, *streams, own.state, self._steps.tree, self._query
        return Launch(pass_of(self._steps), self.length, arguments)

    def write_control(self, words: NDArray[np.uint32]) -> None:
        """Write the words of `control`; no pass may be running."""
        self._control.fill(words)

    def read_control(self) -> NDArray[np.uint32]:
        """Wait for the passes that were launched; returns the words of `control`."""
        return self._control.host()

    def drop_ended(self, kept_count: int) -> None:
        """Compact the streams: launch no more threads for rays that have ended.

        Parameters
        ----------
        kept_count : int
            Number of rays that have not ended.
        """
        chunk_count = -(-self.length // int(CHUNK))
        sums = self._gpu.empty("sums", chunk_count + 1, np.uint32)
        kept = self._gpu.empty("rows", kept_count, np.uint32)
        own, length = self.addresses, np.uint64(self.length)
        shared = own.rows, length, own.state, sums.address
        COUNT_KEPT.launch(self._gpu, chunk_count, shared)
        scan = Scan(self._gpu, chunk_count)
        scan.run(sums.address, chunk_count, sums.address, np.uint32)
        KEEP.launch(self._gpu, chunk_count, (*shared, kept.address))
        self._gpu.wait()  # before memory is freed
        self._rows, self.length = kept, kept_count

    def counts(self) -> NDArray[np.uint32]:
        """Number of hits of each ray."""
        found = np.zeros(self._count, self._columns["found"].layout.dtype)
        self._columns["found"].read(self._streams["found"], found)
        counts: NDArray[np.uint32] = found["count"]
        return counts

    def runs(self) -> NDArray[np.uint32] | None:
        """Number of runs of each kernel on each ray, if counted, of shape (N, 8)."""
        return None if self._runs is None else self._runs.host()

    def _begin(self, part: QueryPart) -> None:
        own = self.addresses, self._goal.wanted, part.status
        BEGIN.launch(self._gpu, self.length, (part.source, part.frame, *own))
