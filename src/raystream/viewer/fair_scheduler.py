"""FairScheduler: picks the next client so that all get the same share of time."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)


class FairScheduler(Generic[Key]):
    """Fair-share scheduling by time used: the client with the least used time is next.

    Idle clients earn no credit: a client that becomes ready starts level with the busy ones,
    so that it runs soon without blocking the others.
    """

    def __init__(self) -> None:
        self._used: dict[Key, float] = {}
        self._waiting: frozenset[Key] = frozenset()
        self._now = 0.0

    def choose(self, ready: Sequence[Key]) -> Key:
        """Return the client to run next, among those with work; the first one of equals."""
        for key in ready:
            if key not in self._waiting:
                self._used[key] = max(self._used.get(key, 0.0), self._now)
        self._waiting = frozenset(ready)
        chosen = min(ready, key=self._used.__getitem__)
        self._now = max(self._now, self._used[chosen])
        return chosen

    def charge(self, key: Key, seconds: float) -> None:
        """Record the time that a client used."""
        if key in self._used:
            self._used[key] += seconds

    def forget(self, key: Key) -> None:
        """Remove a client that has left."""
        self._used.pop(key, None)
        self._waiting -= {key}
