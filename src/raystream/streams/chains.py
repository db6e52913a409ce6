"""Chains: kernels in sequence, repeated, and in loops (Christen 2005, chapter 4.3).

A chain consists of steps, and is a step itself. A step is any object with a method
``run(counters=None)`` that returns a `Count`: a kernel, a chain, or a custom object.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from raystream.core.errors import LoopLimitError
from raystream.streams.counters import Counters

#: Default limit of a loop's rounds.
LOOP_LIMIT = 100_000


def check_limit(name: str, limit: int) -> int:
    """Check a limit of rounds: an integer, at least 1."""
    limit = operator.index(limit)
    if limit < 1:
        raise ValueError(f"{name}, limit: expected at least 1 round, got {limit}")
    return limit


@dataclass(frozen=True)
class Count:
    """The result of a run.

    Attributes
    ----------
    rounds : int
        Rounds of the step: 1 unless it is a loop.
    calls : int
        Kernel executions.
    written : int
        Records written by all of them.
    steps : tuple of Count
        The same for each step of a chain, summed over its rounds.
    """

    rounds: int
    calls: int
    written: int
    steps: tuple[Count, ...] = ()

    def __add__(self, other: Count) -> Count:
        return Count(
            self.rounds + other.rounds,
            self.calls + other.calls,
            self.written + other.written,
            _add(self.steps, other.steps),
        )


class Step(Protocol):
    """Part of a chain."""

    def run(self, counters: Counters | None = None) -> Count:
        """Run it once."""
        ...


class _Chain:
    def __init__(self, steps: Sequence[Step]) -> None:
        name = type(self).__name__
        if not steps:
            raise ValueError(f"{name}: needs at least one step")
        for step in steps:
            if not callable(getattr(step, "run", None)):
                raise TypeError(
                    f"{name}: {step!r:.60} is not a step: expected a kernel, a chain, or an object "
                    "with a method run"
                )
        self.steps = tuple(steps)

    def _round(self, counters: Counters | None) -> tuple[Count, ...]:
        return tuple(step.run(counters) for step in self.steps)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(_name(step) for step in self.steps)})"


class Sequential(_Chain):
    """Steps in sequence (Christen 2005, Figure 4.4).

    Parameters
    ----------
    *steps : Step
    """

    def __init__(self, *steps: Step) -> None:
        super().__init__(steps)

    def run(self, counters: Counters | None = None) -> Count:
        """Run each step once."""
        return _total(1, self._round(counters))


class Repeat(_Chain):
    """Steps, a fixed number of times (Christen 2005, Figure 4.5).

    Parameters
    ----------
    times : int
    *steps : Step
    """

    def __init__(self, times: int, *steps: Step) -> None:
        super().__init__(steps)
        self.times = operator.index(times)
        if self.times < 0:
            raise ValueError(f"Repeat: expected a number of times, got {times}")

    def run(self, counters: Counters | None = None) -> Count:
        """Run the steps that many times."""
        counts: tuple[Count, ...] = ()
        for _ in range(self.times):
            counts = _add(counts, self._round(counters))
        return _total(self.times, counts)


class While(_Chain):
    """Steps, repeated until they write nothing (Christen 2005, Figures 4.6 and 4.7).

    A while-loop of while-loops, with ``idle="all"``, is the nested loop of Listing 4.9.

    Parameters
    ----------
    *steps : Step
    idle : {"last", "all"}
        The loop ends after a round in which the last step, or every step, wrote no record.
    limit : int
        Maximum number of rounds.
    """

    def __init__(self, *steps: Step, idle: str = "last", limit: int = LOOP_LIMIT) -> None:
        super().__init__(steps)
        if idle not in ("last", "all"):
            raise ValueError(f"While: expected idle='last' or idle='all', got {idle!r}")
        self.idle = idle
        self.limit = check_limit("While", limit)

    def run(self, counters: Counters | None = None) -> Count:
        """Run the steps until a round writes nothing.

        Raises
        ------
        LoopLimitError
            If the last round within the limit still wrote records.
        """
        counts: tuple[Count, ...] = ()
        written = 0
        for done in range(1, self.limit + 1):
            latest = self._round(counters)
            counts = _add(counts, latest)
            watched = latest if self.idle == "all" else latest[-1:]
            written = sum(count.written for count in watched)
            if not written:
                return _total(done, counts)
        raise LoopLimitError(repr(self), self.limit, written)


def _add(total: tuple[Count, ...], latest: tuple[Count, ...]) -> tuple[Count, ...]:
    if not total:
        return latest
    if not latest:
        return total
    return tuple(a + b for a, b in zip(total, latest, strict=True))


def _total(rounds: int, counts: tuple[Count, ...]) -> Count:
    calls = sum(count.calls for count in counts)
    written = sum(count.written for count in counts)
    return Count(rounds, calls, written, counts)


def _name(step: Step) -> str:
    name = getattr(step, "name", None)
    return name if isinstance(name, str) else repr(step)
