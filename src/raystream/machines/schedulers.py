"""Schedulers: the choice of the next kernel of a multipass machine.

Purcell 2002, section 3.2, calls it an oracle; Foley 2005, section 3.4, load balancing. Every
choice leads to the same hits and the same steps of every ray, in a different number of passes.
Where shading spawns rays, it is chosen like the other kernels that do not intersect, so that a
loop has rays of several bounces at a time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from raystream.core.choices import SCHEDULERS, Multipass
from raystream.machines.records import RayState
from raystream.machines.steps.base import StepKernel

__all__ = [
    "DEFAULT_THRESHOLD",
    "SCHEDULERS",
    "Double",
    "MostWork",
    "Naive",
    "Queues",
    "Scheduler",
    "Threshold",
    "make_scheduler",
]

#: The share of waiting rays at which it pays to intersect (Purcell 2002, section 3.2).
DEFAULT_THRESHOLD = 0.2


class Queues(NamedTuple):
    """The number of rays that wait for each kernel.

    Attributes
    ----------
    kernels : sequence of StepKernel
        Set-up first, shading last.
    waiting : sequence of int
        Rays that wait for each; not all 0.
    latest : int or None
        The kernel that ran last.
    spawns : bool
        Whether shading spawns rays, which are traced in the same loop: it need not wait for all
        others.
    """

    kernels: Sequence[StepKernel]
    waiting: Sequence[int]
    latest: int | None
    spawns: bool = False

    @property
    def tests(self) -> list[int]:
        """The kernels that intersect, if rays wait for them."""
        return [k for k in self._searching() if self._is_test(k)]

    @property
    def others(self) -> list[int]:
        """The kernels that do not intersect, if rays wait for them; shading only if it spawns."""
        return [k for k in self._searching() if not self._is_test(k)]

    @property
    def shading(self) -> int:
        """The kernel that shades."""
        return len(self.kernels) - 1

    def fullest(self, among: Iterable[int]) -> int:
        """The kernel with the most rays; the first one on ties."""
        return max(among, key=lambda k: self.waiting[k])

    def _searching(self) -> list[int]:
        return [k for k in range(self.shading + self.spawns) if self.waiting[k]]

    def _is_test(self, k: int) -> bool:
        return self.kernels[k].state is RayState.INTERSECTING


class Scheduler(Protocol):
    """Chooses kernels."""

    def choose(self, queues: Queues) -> int:
        """The index of a kernel for which rays wait."""
        ...


class Naive:
    """Intersect as soon as any ray waits for it (Purcell 2002, section 3.2).

    Otherwise the last of the other kernels for which rays wait runs, and shading when all rays
    have ended, or like the other kernels if it spawns rays.
    """

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        tests, others = queues.tests, queues.others
        if tests:
            return tests[0]
        return others[-1] if others else queues.shading


class Threshold:
    """Intersect once a share of the active rays waits for it (Purcell 2002, section 3.2).

    Until then the fullest of the other kernels runs, and shading when all rays have ended, or like
    the other kernels if it spawns rays.

    Parameters
    ----------
    share : float
        0 to 1.
    """

    def __init__(self, share: float = DEFAULT_THRESHOLD) -> None:
        self.share = share

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        tests, others = queues.tests, queues.others
        active = sum(queues.waiting[k] for k in (*tests, *others))
        if tests and (not others or queues.waiting[tests[0]] >= self.share * active):
            return tests[0]
        return queues.fullest(others) if others else queues.shading


class MostWork:
    """Run the kernel for which most rays wait (Delany 1988, after Purcell 2002, section 3.2)."""

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        return queues.fullest(range(len(queues.kernels)))


class Double:
    """Keep the kernel until another has more than twice as many rays (Foley 2005, section 3.4)."""

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        best = queues.fullest(range(len(queues.kernels)))
        latest = queues.latest
        if latest is None or queues.waiting[best] > 2 * queues.waiting[latest]:
            return best
        return latest


def make_scheduler(scheduler: str | Scheduler, threshold: float = DEFAULT_THRESHOLD) -> Scheduler:
    """The scheduler of a name; an object with a method ``choose`` is returned.

    Raises
    ------
    ValueError
        If the name is unknown, or the threshold is not in 0 to 1.
    TypeError
        If it is neither a name nor such an object.
    """
    Multipass(scheduler=scheduler, threshold=threshold)  # checks both
    if not isinstance(scheduler, str):
        return scheduler
    made: dict[str, Scheduler] = {
        "threshold": Threshold(float(threshold)),
        "naive": Naive(),
        "most-work": MostWork(),
        "double": Double(),
    }
    return made[scheduler]
