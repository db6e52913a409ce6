"""Loops over passes: batches launched by the host, or a graph that loops on the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from raystream.cuda.multipass.control import (
    MOST_PASSES,
    Rules,
    begin_control,
    pass_count,
    write_limits,
)
from raystream.cuda.multipass.ray_streams import RayStreams
from raystream.jit.cuda import DeviceLoop

__all__ = ["LOOPS", "Loop"]

#: Passes per batch: initially, and at most.
_FIRST_PASSES = 8
_MOST_AT_ONCE = 64


class Loop(Protocol):
    """Runs passes over some rays."""

    def run(self, most: int) -> NDArray[np.uint32]:
        """Run at most `most` passes; returns the words of `control` after the last."""
        ...

    def renew(self) -> None:
        """Update the launches after a compaction."""
        ...


class Batches:
    """The host launches some passes, which do nothing once no ray is active, and reads the result.

    Parameters
    ----------
    streams : RayStreams
    rules : Rules
    """

    def __init__(self, streams: RayStreams, rules: Rules) -> None:
        self._streams, self._rules = streams, rules
        self._length = _FIRST_PASSES
        self._runs: list[Callable[[], None]] = []
        self.renew()

    def renew(self) -> None:
        """See `Loop.renew`."""
        self._runs = self._streams.prepared(self._rules)

    def run(self, most: int) -> NDArray[np.uint32]:
        """See `Loop.run`."""
        for _ in range(min(self._length, most)):
            for run in self._runs:
                run()
        self._length = min(2 * self._length, _MOST_AT_ONCE)
        return self._streams.read_control()


class DeviceGraph:
    """The device loops by itself until the log of passes is full or the streams can be compacted.

    Parameters
    ----------
    streams : RayStreams
    rules : Rules

    Raises
    ------
    CudaError
        If the driver does not support conditional graph nodes, which need CUDA 12.4.
    """

    def __init__(self, streams: RayStreams, rules: Rules) -> None:
        self._streams, self._rules = streams, rules
        self._words = begin_control(streams.kernels, streams.length)
        self._known = 0
        self._loop: DeviceLoop | None = None
        self.renew()

    def renew(self) -> None:
        """See `Loop.renew`."""
        self._loop = self._streams.loop(self._rules)

    def run(self, most: int) -> NDArray[np.uint32]:
        """See `Loop.run`."""
        assert self._loop is not None
        write_limits(self._words, self._known + min(most, MOST_PASSES), self._streams.length)
        self._streams.write_control(self._words)
        self._loop.begin()
        self._words = self._streams.read_control()
        self._known = pass_count(self._words)
        return self._words


#: By the value of the machine's option ``loop``.
LOOPS: dict[str, Callable[[RayStreams, Rules], Loop]] = {"graph": DeviceGraph, "batches": Batches}
