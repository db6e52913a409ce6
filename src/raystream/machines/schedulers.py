"""Schedulers: which kernel a multipass machine runs next.

Purcell 2002, section 3.2, calls it an oracle; Foley 2005, section 3.4, load balancing. Every
choice leads to the same hits, and to the same steps of every ray; what differs is how many
passes it takes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple, Protocol

from raystream.core.choices import SCHEDULERS, Multipass
from raystream.machines.records import RayState
from raystream.machines.steps.base import StepKernel

__all__ = [
    "SCHEDULERS",
    "USUAL_THRESHOLD",
    "Double",
    "MostWork",
    "Naive",
    "Queues",
    "Scheduler",
    "Threshold",
    "make_scheduler",
]

#: The share of waiting rays at which it pays to intersect (Purcell 2002, section 3.2).
USUAL_THRESHOLD = 0.2


class Queues(NamedTuple):
    """What rays wait for.

    Attributes
    ----------
    kernels : sequence of StepKernel
        In the order of a ray's way: the one that begins first, shading last.
    waiting : sequence of int
        How many rays wait for each. Some ray waits.
    latest : int or None
        The kernel that ran last.
    """

    kernels: Sequence[StepKernel]
    waiting: Sequence[int]
    latest: int | None

    @property
    def tests(self) -> list[int]:
        """The kernels that intersect, of those that rays wait for."""
        return [k for k in self._on_way() if self._is_test(k)]

    @property
    def others(self) -> list[int]:
        """Those that neither intersect nor shade."""
        return [k for k in self._on_way() if not self._is_test(k)]

    @property
    def shading(self) -> int:
        """The kernel that ends a ray's way."""
        return len(self.kernels) - 1

    def fullest(self, among: Iterable[int]) -> int:
        """The kernel with the most rays, the first of equal ones."""
        return max(among, key=lambda k: self.waiting[k])

    def _on_way(self) -> list[int]:
        return [k for k in range(self.shading) if self.waiting[k]]

    def _is_test(self, k: int) -> bool:
        return self.kernels[k].state is RayState.INTERSECTING


class Scheduler(Protocol):
    """Chooses kernels."""

    def choose(self, queues: Queues) -> int:
        """The number of a kernel for which some ray waits."""
        ...


class Naive:
    """Intersect as soon as any ray waits for it (Purcell 2002, section 3.2).

    Where no ray does, the kernel that comes last on a ray's way runs, and shading when all rays
    have ended.
    """

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        tests, others = queues.tests, queues.others
        if tests:
            return tests[0]
        return others[-1] if others else queues.shading


class Threshold:
    """Intersect once a share of the active rays waits for it (Purcell 2002, section 3.2).

    Until then the fullest of the other kernels runs, and shading when all rays have ended.

    Parameters
    ----------
    share : float
        0 to 1.
    """

    def __init__(self, share: float = USUAL_THRESHOLD) -> None:
        self.share = share

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        tests, others = queues.tests, queues.others
        active = sum(queues.waiting[k] for k in (*tests, *others))
        if tests and (not others or queues.waiting[tests[0]] >= self.share * active):
            return tests[0]
        return queues.fullest(others) if others else queues.shading


class MostWork:
    """The kernel for which most rays wait (Delany 1988, after Purcell 2002, section 3.2)."""

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        return queues.fullest(range(len(queues.kernels)))


class Double:
    """Stay until another kernel has more than twice as many rays (Foley 2005, section 3.4)."""

    def choose(self, queues: Queues) -> int:
        """See `Scheduler.choose`."""
        best = queues.fullest(range(len(queues.kernels)))
        latest = queues.latest
        if latest is None or queues.waiting[best] > 2 * queues.waiting[latest]:
            return best
        return latest


def make_scheduler(scheduler: str | Scheduler, threshold: float = USUAL_THRESHOLD) -> Scheduler:
    """Find a scheduler by name; an object that chooses stays as it is.

    Raises
    ------
    ValueError
        If there is none of that name, or the threshold is no share.
    TypeError
        If it is neither a name nor has a method ``choose``.
    """
    Multipass(scheduler=scheduler, threshold=threshold)  # raises what is wrong
    if not isinstance(scheduler, str):
        return scheduler
    made: dict[str, Scheduler] = {
        "threshold": Threshold(float(threshold)),
        "naive": Naive(),
        "most-work": MostWork(),
        "double": Double(),
    }
    return made[scheduler]
