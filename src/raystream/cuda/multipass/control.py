"""Control words in device memory: the rays waiting for each kernel, its choice, a log of passes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.machines.records import RayState
from raystream.machines.schedulers import SCHEDULERS
from raystream.machines.steps.base import StepKernel

__all__ = [
    "CHOSEN",
    "COUNTS",
    "DROPPING",
    "LATEST",
    "LAUNCHED",
    "LENGTH",
    "LOG",
    "LOG_BYTES",
    "MOST_PASSES",
    "NO_KERNEL",
    "PASS_COUNT",
    "STATES",
    "UNTIL",
    "LoggedPass",
    "Rules",
    "begin_control",
    "pass_count",
    "read_active",
    "read_passes",
    "rules_of",
    "write_limits",
]

#: Passes in the log: as many may run before the host reads it.
MOST_PASSES = 1024

#: Maximum number of kernels, and of states.
_MOST_KERNELS, _MOST_STATES = 8, 16

#: Offsets of words in bytes: the kernel that runs, if any; the latest one; length of the streams,
#: as passes report it; whether to drop rays that have ended; passes so far, and the number of
#: passes at which the device returns to the host; rays per launch.
CHOSEN, LATEST, LENGTH, DROPPING, PASS_COUNT, UNTIL, LAUNCHED = (np.uint64(4 * k) for k in range(7))

#: Offsets of the rays in each state, of the state that each kernel advances, and of the log of
#: passes: kernel, rays that it ran on, length of the streams.
COUNTS, STATES, LOG = np.uint64(32), np.uint64(96), np.uint64(128)

#: Bytes of a logged pass.
LOG_BYTES = np.uint64(12)
#: Number that stands for no kernel.
NO_KERNEL = np.uint32(2**32 - 1)


class Rules(NamedTuple):
    """The scheduler's rules.

    Attributes
    ----------
    kernel_count : uint64
    tests : uint64
        A bit for each kernel that intersects.
    scheduler : uint64
        Index of its name in `machines.schedulers.SCHEDULERS`.
    share : float64
        For ``"threshold"``.
    compacts : bool
    """

    kernel_count: np.uint64
    tests: np.uint64
    scheduler: np.uint64
    share: np.float64
    compacts: bool


class LoggedPass(NamedTuple):
    """A pass, from the log.

    Attributes
    ----------
    kernel : int
        Its number.
    run_count, record_count : int
        Number of rays that it ran on, and in the streams.
    """

    kernel: int
    run_count: int
    record_count: int


def rules_of(kernels: Sequence[StepKernel], scheduler: str, share: float, compacts: bool) -> Rules:
    """The rules of a scheduler, given by name, for these kernels."""
    assert len(kernels) <= _MOST_KERNELS
    tests = sum(
        1 << number for number, one in enumerate(kernels) if one.state is RayState.INTERSECTING
    )
    return Rules(
        np.uint64(len(kernels)),
        np.uint64(tests),
        np.uint64(SCHEDULERS.index(scheduler)),
        np.float64(share),
        bool(compacts),
    )


def begin_control(kernels: Sequence[StepKernel], count: int) -> NDArray[np.uint32]:
    """Initial words: `count` rays wait for the first kernel."""
    words = np.zeros(int(LOG) // 4 + 3 * MOST_PASSES, np.uint32)
    words[int(CHOSEN) // 4] = words[int(LATEST) // 4] = NO_KERNEL
    words[int(LENGTH) // 4] = count
    words[int(COUNTS) // 4 + int(kernels[0].state)] = count
    for number, one in enumerate(kernels):
        words[int(STATES) // 4 + number] = int(one.state)
    return words


def write_limits(words: NDArray[np.uint32], until: int, length: int) -> None:
    """Set the number of passes at which to return to the host, and the rays per launch."""
    words[int(UNTIL) // 4], words[int(LAUNCHED) // 4] = until, length


def pass_count(words: NDArray[np.uint32]) -> int:
    """Number of passes so far."""
    return int(words[int(PASS_COUNT) // 4])


def read_passes(words: NDArray[np.uint32], known: int) -> list[LoggedPass]:
    """The passes after the `known` ones, at most `MOST_PASSES`."""
    log = words[int(LOG) // 4 :].reshape(-1, 3)
    latest = range(known, pass_count(words))
    return [LoggedPass(*log[number % MOST_PASSES].tolist()) for number in latest]


def read_active(words: NDArray[np.uint32]) -> int:
    """Number of rays that wait for a kernel."""
    states = words[int(STATES) // 4 :][:_MOST_KERNELS]
    counts = words[int(COUNTS) // 4 :][:_MOST_STATES]
    return int(counts[states[states != RayState.DONE]].sum(dtype=np.int64))
