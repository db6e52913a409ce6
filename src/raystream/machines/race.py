"""Race kernels on pieces of a large batch, and give the rest to the fastest.

All kernels give the same bits, so no ray is traced twice. The kernel that is thought the fastest
traces two pieces of an eighth of the batch; its rivals trace smaller ones between them, so that a
rival of half the speed costs a few percent. A rival that was not much slower traces a larger piece:
lists of few rays share few nodes. Times are kept for later batches of the same kind, which race
again after twice as many batches each time.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from raystream.jit.threads import Progress, part_of

#: Batches of fewer rays are not raced: threads would start and end too often.
LEAST_RACE = 1 << 16

#: Pieces of the kernel that is thought the fastest, of its rivals, and of rivals in doubt, relative
#: to the batch.
_FAVOURITE = 1 / 8
_RIVAL = 1 / 48
_IN_DOUBT = 1 / 12

#: Least rays of a piece.
_LEAST_PIECE = 4096

#: A rival is in doubt if it took at most this many times as long as the favourite.
_NEAR = 2.0

#: A rival must be faster than the kernel that was guessed by this factor: pieces vary.
_LEAD = 1.05

#: Kinds of batches whose times are kept.
_MOST_KINDS = 256

#: Traces rays of a batch by a kernel: (kernel, first ray, end, progress).
Run = Callable[[str, int, int, Progress | None], object]

#: The last place at or before a ray where a batch may be divided.
Cut = Callable[[int], int]

#: Held by a race.
_racing = threading.Lock()


@dataclass
class _Kind:
    """Times of a kind of batch.

    Attributes
    ----------
    numbers : iterator of int
        Of the batches, from 1 on: several threads take them.
    rates : dict of str to float
        Seconds per ray by kernel.
    """

    numbers: Iterator[int] = field(default_factory=lambda: itertools.count(1))
    rates: dict[str, float] = field(default_factory=dict)


class _Time(NamedTuple):
    """How long some rays took."""

    seconds: float
    rays: int

    @property
    def rate(self) -> float:
        """Seconds per ray."""
        return self.seconds / max(self.rays, 1)


def _rate(time: _Time) -> float:
    return time.rate


class Races:
    """Times of the kernels by kind of batch.

    Parameters
    ----------
    kinds : dict, optional
        Keeps them; see `Structure.kernel_times`.
    """

    def __init__(self, kinds: dict[Hashable, Any] | None = None) -> None:
        self._kinds: dict[Hashable, _Kind] = {} if kinds is None else kinds

    def plan(self, kind: Hashable, names: Sequence[str], is_ready: bool) -> tuple[str, bool]:
        """The kernel for a batch of a kind, and whether to race.

        Parameters
        ----------
        kind : hashable
        names : sequence of str
            The kernel to take before any race, then its rivals.
        is_ready : bool
            Whether all of them are loaded: else only later batches are worth it.
        """
        if kind not in self._kinds and len(self._kinds) >= _MOST_KINDS:
            self._kinds.clear()
        known = self._kinds.setdefault(kind, _Kind())
        number = next(known.numbers)
        is_due = number & (number - 1) == 0 and (is_ready or number >= 4)
        return _fastest(names, known.rates), is_due

    def learn(self, kind: Hashable, rates: dict[str, float]) -> None:
        """Keep the seconds per ray of a race: the mean with those of earlier ones."""
        known = self._kinds.setdefault(kind, _Kind())
        for name, rate in rates.items():
            known.rates[name] = 0.5 * (known.rates.get(name, rate) + rate)

    def fastest(self, kind: Hashable, names: Sequence[str]) -> str:
        """The fastest kernel of a kind of batch; the first one if nothing is known."""
        known = self._kinds.get(kind)
        return _fastest(names, known.rates if known else {})


def _fastest(names: Sequence[str], rates: dict[str, float]) -> str:
    best = names[0]
    for name in names[1:]:
        if name in rates and best in rates and rates[name] * _LEAD < rates[best]:
            best = name
    return best


def run_fastest(
    names: Sequence[str],
    count: int,
    cut: Cut,
    run: Run,
    races: Races,
    kind: Hashable,
    progress: Progress | None,
    cold: Sequence[str],
) -> None:
    """Trace a batch by the fastest kernel, as far as that is known; see `run_race`.

    Notes
    -----
    One race at a time: two would measure each other. A batch that is due meanwhile is not raced.
    """
    name, is_due = races.plan(kind, names, not cold)
    if not is_due or not _racing.acquire(blocking=False):
        run(name, 0, count, progress)
        return
    try:
        run_race(names, count, cut, run, races, kind, progress, cold)
    finally:
        _racing.release()


def run_race(
    names: Sequence[str],
    count: int,
    cut: Cut,
    run: Run,
    races: Races,
    kind: Hashable,
    progress: Progress | None,
    cold: Sequence[str] = (),
) -> None:
    """Trace a batch: pieces by each kernel, the rest by the fastest.

    Parameters
    ----------
    names : sequence of str
        Kernels; the first one is the guess.
    count : int
        Rays of the batch.
    cut : callable
    run : callable
    races : Races
    kind : hashable
        Of the batch.
    progress : callable, optional
        Called with (rays done, rays).
    cold : sequence of str
        Kernels to run before they are timed, as they must be loaded.
    """
    done = 0

    def trace(name: str, begin: int, end: int) -> _Time:
        """Trace a piece."""
        nonlocal done
        if begin >= end:
            return _Time(0.0, 0)
        started = clock()
        run(name, begin, end, part_of(progress, done, count))
        done += end - begin
        return _Time(clock() - started, end - begin)

    def after(begin: int, share: float) -> int:
        """The end of a piece."""
        return cut(begin + max(int(share * count), _LEAST_PIECE))

    favourite = races.fastest(kind, names)
    first = cut(int((0.5 - _FAVOURITE) * count))
    at = first
    for name in cold:
        begin, at = at, after(at, 0.0)
        trace(name, begin, at)
    begin, at = at, after(at, _FAVOURITE)
    before = trace(favourite, begin, at)
    times: dict[str, _Time] = {}
    for name in names:
        if name == favourite:
            continue
        begin, at = at, after(at, _RIVAL)
        times[name] = trace(name, begin, at)
        if times[name].rate <= _NEAR * before.rate:
            begin, at = at, after(at, _IN_DOUBT)
            # Alone: the first piece may have been too small.
            times[name] = trace(name, begin, at)
    begin, at = at, after(at, _FAVOURITE)
    behind = trace(favourite, begin, at)
    # The faster of its pieces: another program that runs during one of them does not decide.
    times[favourite] = min((one for one in (before, behind) if one.rays), key=_rate, default=before)
    races.learn(kind, {name: found.rate for name, found in times.items() if found.rays})
    winner = races.fastest(kind, names)
    trace(winner, 0, first)
    trace(winner, at, count)


#: The time, in seconds.
clock = time.perf_counter
