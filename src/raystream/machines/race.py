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
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

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

#: Rays of a batch to trace by a kernel: (kernel, first ray, end).
Piece = tuple[str, int, int]

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


class Races:
    """Times of the kernels by kind of batch.

    Parameters
    ----------
    kinds : dict, optional
        Keeps them; see `Structure.kernel_times`.
    """

    def __init__(self, kinds: dict[Hashable, Any] | None = None) -> None:
        self._kinds: dict[Hashable, _Kind] = {} if kinds is None else kinds

    def is_due(self, kind: Hashable, is_ready: bool) -> bool:
        """Whether to race the next batch of a kind.

        Parameters
        ----------
        kind : hashable
        is_ready : bool
            Whether all its kernels are loaded: else only later batches are worth it.
        """
        if kind not in self._kinds and len(self._kinds) >= _MOST_KINDS:
            self._kinds.clear()
        number = next(self._kinds.setdefault(kind, _Kind()).numbers)
        return number & (number - 1) == 0 and (is_ready or number >= 4)

    def learn(self, kind: Hashable, rates: dict[str, float]) -> None:
        """Keep the seconds per ray of a race: the mean with those of earlier ones."""
        known = self._kinds.setdefault(kind, _Kind())
        for name, rate in rates.items():
            known.rates[name] = 0.5 * (known.rates.get(name, rate) + rate)

    def fastest(self, kind: Hashable, names: Sequence[str]) -> str:
        """The fastest kernel of a kind of batch; the first one if nothing is known."""
        rates, best = self._kinds.get(kind, _Kind()).rates, names[0]
        for name in names[1:]:
            if name in rates and best in rates and rates[name] * _LEAD < rates[best]:
                best = name
        return best


def race(
    races: Races, kind: Hashable, names: Sequence[str], cold: Sequence[str], count: int, cut: Cut
) -> Generator[Piece, None, None]:
    """Decide which kernel traces which rays of a batch; the caller traces each piece at once.

    Parameters
    ----------
    races : Races
    kind : hashable
        Of the batch.
    names : sequence of str
        Kernels; the first one is the guess.
    cold : sequence of str
        Kernels to run before they are timed, as they must be loaded.
    count : int
        Rays of the batch.
    cut : callable

    Notes
    -----
    One race at a time: two would measure each other. A batch that is due meanwhile is not raced.
    """
    if not races.is_due(kind, not cold) or not _racing.acquire(blocking=False):
        yield races.fastest(kind, names), 0, count
        return
    try:
        yield from _pieces(races, kind, names, cold, count, cut)
    finally:
        _racing.release()


def _pieces(
    races: Races, kind: Hashable, names: Sequence[str], cold: Sequence[str], count: int, cut: Cut
) -> Generator[Piece, None, None]:
    """Pieces by each kernel, the rest by the fastest."""
    at = first = cut(int((0.5 - _FAVOURITE) * count))

    def timed(name: str, share: float) -> Generator[Piece, None, float]:
        """The next piece; returns its seconds per ray, 0 if it has none."""
        nonlocal at
        begin, at = at, cut(at + max(int(share * count), _LEAST_PIECE))
        if begin >= at:
            return 0.0
        started = clock()
        yield name, begin, at
        return (clock() - started) / (at - begin)

    for name in cold:
        yield from timed(name, 0.0)
    favourite, rates = races.fastest(kind, names), {}
    before = yield from timed(favourite, _FAVOURITE)
    for name in names:
        if name == favourite:
            continue
        rates[name] = yield from timed(name, _RIVAL)
        if rates[name] <= _NEAR * before:
            # Alone: the first piece may have been too small.
            rates[name] = yield from timed(name, _IN_DOUBT)
    behind = yield from timed(favourite, _FAVOURITE)
    # The faster of its pieces: another program that runs during one of them does not decide.
    rates[favourite] = min(filter(None, (before, behind)), default=0.0)
    races.learn(kind, {name: rate for name, rate in rates.items() if rate})
    winner = races.fastest(kind, names)
    for begin, end in ((0, first), (at, count)):
        if begin < end:
            yield winner, begin, end


#: The time, in seconds.
clock = time.perf_counter
