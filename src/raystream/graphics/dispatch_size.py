"""DispatchSize: the number of rays of a dispatch, adapted so that none takes long."""

from __future__ import annotations

#: Rays of the first dispatch: few, since a slow structure must not take minutes.
_FIRST = 1 << 10

#: Seconds that a dispatch should take: long against its overhead, but Ctrl-C and progress wait for
#: its end, and drivers take one of some seconds for hung.
_SECONDS = 0.2

#: Largest growth from one dispatch to the next.
_GROWTH = 8


class DispatchSize:
    """The number of rays of the next dispatch, from the times of those before.

    Parameters
    ----------
    most : int
        Upper bound.

    Attributes
    ----------
    size : int
        Rays of the next dispatch, at least 1.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self.size = min(_FIRST, most)

    def took(self, count: int, seconds: float) -> None:
        """Take in the time of a dispatch."""
        if count < self.size and seconds <= _SECONDS:
            return  # the last rays of a batch: too few to extrapolate
        right = int(count * _SECONDS / max(seconds, 1e-9))
        self.size = max(1, min(right, self.size * _GROWTH, self._most))
