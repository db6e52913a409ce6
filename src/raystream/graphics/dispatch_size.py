"""DispatchSize: how many rays a dispatch gets, so that none takes long."""

from __future__ import annotations

__all__ = ["DispatchSize"]

#: Rays of the first dispatch. One of a hopeless search must not take minutes.
_FIRST = 1 << 10

#: Seconds that a dispatch should take: long beside what it costs to begin one; but Ctrl-C waits
#: for its end, progress is told then, and a driver may take one of some seconds for hung.
_SECONDS = 0.2

#: The next one has at most so many times the rays.
_GROWTH = 8


class DispatchSize:
    """How many rays the next dispatch gets, by how long those before took.

    Parameters
    ----------
    most : int
        More are never given.

    Attributes
    ----------
    size : int
        Rays of the next dispatch, at least 1.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.size = min(_FIRST, most)

    def took(self, count: int, seconds: float) -> None:
        """Tell how long a dispatch of so many rays took."""
        if count < self.size and seconds <= _SECONDS:
            return  # the last ones of a batch: they tell too little
        right = int(count * _SECONDS / max(seconds, 1e-9))
        self.size = max(1, min(right, self.size * _GROWTH, self._most))
