"""Times of kernels by kind of batch, as races measure them: which is the fastest.

Times are kept for later batches of the same kind, which race again after twice as many batches each
time.
"""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

#: A rival must be faster than the kernel that was guessed by this factor: pieces vary.
_LEAD = 1.05

#: Kinds of batches whose times are kept.
_MOST_KINDS = 256


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
