"""Control: words in the device's memory that say how many rays wait for each kernel, and more."""

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
    "LENGTH",
    "LOG",
    "LOG_BYTES",
    "LOOKED_AT",
    "MOST_PASSES",
    "NO_KERNEL",
    "PASS_COUNT",
    "STATES",
    "UNTIL",
    "Ran",
    "Rules",
    "begin_control",
    "pass_count",
    "read_active",
    "read_ended",
    "read_passes",
    "rules_of",
    "write_limits",
]

#: Passes that may run before the host looks at them.
MOST_PASSES = 1024

#: Kernels, and states, for which there is room.
_MOST_KERNELS, _MOST_STATES = 8, 16

#: Where words are, in bytes: the kernel that runs, if any; the one that was chosen last; length of
#: the streams, as passes report it; whether rays that have ended are to be dropped; passes so far,
#: and after how many the host wants to look; how many rays passes look at.
CHOSEN, LATEST, LENGTH, DROPPING, PASS_COUNT, UNTIL, LOOKED_AT = (
    np.uint64(4 * k) for k in range(7)
)

#: Rays in each state, and the state that each kernel waits for; then the latest passes: kernel,
#: rays that it ran on, length of the streams.
COUNTS, STATES, LOG = np.uint64(32), np.uint64(96), np.uint64(128)

#: Bytes of a pass.
LOG_BYTES = np.uint64(12)
#: Instead of a kernel's number.
NO_KERNEL = np.uint32(2**32 - 1)


class Rules(NamedTuple):
    """How kernels are chosen.

    Attributes
    ----------
    kernel_count : uint64
    tests : uint64
        A bit for each kernel that intersects.
    scheduler : uint64
        Number of the name in `machines.schedulers.SCHEDULERS`.
    share : float64
        For ``"threshold"``.
    compacts : bool
    """

    kernel_count: np.uint64
    tests: np.uint64
    scheduler: np.uint64
    share: np.float64
    compacts: bool


class Ran(NamedTuple):
    """A pass.

    Attributes
    ----------
    kernel : int
        Its number.
    run_count, record_count : int
        Rays that it ran on, and those in the streams.
    """

    kernel: int
    run_count: int
    record_count: int


def rules_of(kernels: Sequence[StepKernel], scheduler: str, share: float, compacts: bool) -> Rules:
    """How a scheduler, by its name, chooses of these kernels."""
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
    """The words when `count` rays wait for the first kernel."""
    words = np.zeros(int(LOG) // 4 + 3 * MOST_PASSES, np.uint32)
    words[int(CHOSEN) // 4] = words[int(LATEST) // 4] = NO_KERNEL
    words[int(LENGTH) // 4] = count
    words[int(COUNTS) // 4 + int(kernels[0].state)] = count
    for number, one in enumerate(kernels):
        words[int(STATES) // 4 + number] = int(one.state)
    return words


def write_limits(words: NDArray[np.uint32], until: int, length: int) -> None:
    """Say after how many passes the host wants to look, and how many rays passes look at."""
    words[int(UNTIL) // 4], words[int(LOOKED_AT) // 4] = until, length


def pass_count(words: NDArray[np.uint32]) -> int:
    """How many passes there were."""
    return int(words[int(PASS_COUNT) // 4])


def read_passes(words: NDArray[np.uint32], known: int) -> list[Ran]:
    """The passes after the `known` ones, at most `MOST_PASSES`."""
    log = words[int(LOG) // 4 :].reshape(-1, 3)
    latest = range(known, pass_count(words))
    return [Ran(*log[number % MOST_PASSES].tolist()) for number in latest]


def read_active(words: NDArray[np.uint32]) -> int:
    """Rays that wait for any kernel."""
    states = words[int(STATES) // 4 :][:_MOST_KERNELS]
    counts = words[int(COUNTS) // 4 :][:_MOST_STATES]
    return int(counts[states[states != RayState.DONE]].sum(dtype=np.int64))


def read_ended(words: NDArray[np.uint32], state: RayState = RayState.DONE) -> int:
    """Rays in the streams that have ended, as passes report their length; or overflown ones."""
    return int(words[int(COUNTS) // 4 + int(state)])
