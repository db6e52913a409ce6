"""Hits in buffers that grow where rays have many."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar


class Buffers(Protocol):
    """Memory for the hits of some rays."""

    @property
    def capacity(self) -> int:
        """Hits that fit."""


B = TypeVar("B", bound=Buffers)


class GrowingBuffers(Generic[B]):
    """Run a kernel that stops when its buffers are full, until all is done.

    Parameters
    ----------
    make : callable
        Allocates buffers for a number of hits; raises MemoryError if that is too much.
    fill : callable
        ``fill(begin, end, buffers, *memory)`` traces as many rays as the buffers allow, delivers
        their hits, and returns where it stopped. If that is `begin`, it gets larger buffers.
    capacity : int
        Of the first buffers.

    Notes
    -----
    Buffers are reused, by any thread.
    """

    def __init__(
        self,
        make: Callable[[int], B],
        fill: Callable[..., int],
        capacity: int,
    ) -> None:
        self._make = make
        self._fill = fill
        self._first_capacity = capacity
        self._spare: list[B] = []  # of the threads between two calls

    def __call__(self, begin: int, end: int, *memory: int) -> None:
        """Do all from begin to end; the body of a `parallel_for`."""
        buffers = self._take()
        if begin == end:  # compile
            self._fill(begin, end, buffers, *memory)
        while begin < end:
            reached = self._fill(begin, end, buffers, *memory)
            if reached == begin:
                buffers = self._make(2 * buffers.capacity)
            begin = reached
        self._spare.append(buffers)

    def _take(self) -> B:
        try:
            return self._spare.pop()
        except IndexError:
            return self._make(self._first_capacity)
