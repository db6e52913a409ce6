"""Turns: whose work is done next, so that each gets the same share of the time."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Generic, TypeVar

__all__ = ["Turns"]

Key = TypeVar("Key", bound=Hashable)


class Turns(Generic[Key]):
    """Fair turns by time used: who has had the least is next.

    Who had nothing to do for a while gets no credit for it, and comes as if it had used as much
    as those who are at work: so that it is soon next, but does not keep the others waiting.
    """

    def __init__(self) -> None:
        self._used: dict[Key, float] = {}
        self._waiting: frozenset[Key] = frozenset()
        self._now = 0.0

    def choose(self, ready: Sequence[Key]) -> Key:
        """The one of those which have work that is to do it now; the first of equals."""
        for key in ready:
            if key not in self._waiting:
                self._used[key] = max(self._used.get(key, 0.0), self._now)
        self._waiting = frozenset(ready)
        chosen = min(ready, key=self._used.__getitem__)
        self._now = max(self._now, self._used[chosen])
        return chosen

    def charge(self, key: Key, seconds: float) -> None:
        """Note that it used so much time."""
        if key in self._used:
            self._used[key] += seconds

    def forget(self, key: Key) -> None:
        """Drop what is known of one that has left."""
        self._used.pop(key, None)
        self._waiting -= {key}
