"""Loops: pass after pass, until no ray is active or the host wants to look."""

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

#: Passes that are begun together: at first, and at most.
_FIRST_PASSES = 8
_MOST_AT_ONCE = 64


class Loop(Protocol):
    """Runs passes over some rays."""

    def run(self, most: int) -> NDArray[np.uint32]:
        """Run at most `most` passes; returns the words of `control` after them."""
        ...

    def renew(self) -> None:
        """Take note that other rays are looked at than before."""
        ...


class Batches:
    """The host begins some passes, which find nothing to do if no ray is left, and looks.

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
        return self._streams.look()


class DeviceGraph:
    """The device goes round by itself, until the record of passes is full or rays can be dropped.

    Parameters
    ----------
    streams : RayStreams
    rules : Rules

    Raises
    ------
    CudaError
        If the driver has no such loops: they came with CUDA 12.4.
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
        self._streams.tell(self._words)
        self._loop.begin()
        self._words = self._streams.look()
        self._known = pass_count(self._words)
        return self._words


#: By the name that the machine takes.
LOOPS: dict[str, Callable[[RayStreams, Rules], Loop]] = {"batches": Batches, "graph": DeviceGraph}
