"""Threads of a block: all of them meet at barriers, and those of a warp at votes.

A vote has the threads that have reached the same instruction when no thread can continue. A device
may have fewer threads there at once, but never more.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from ptx.memory import PtxError

WARP_SIZE = 32

#: Where a thread waits for all others of its block.
BARRIER = object()


class Meeting(NamedTuple):
    """A thread that waits for others of its warp.

    Attributes
    ----------
    kind : str
        ``"activemask"``, ``"match"``, ``"ballot"``, ``"any"`` or ``"all"``.
    lane : int
    voters : int
        Mask of the threads that must vote; 0 for all that are active.
    value : object
        What the thread says.
    answer : callable
        Takes what comes of it.
    """

    kind: str
    lane: int
    voters: int
    value: Any
    answer: Callable[[Any], None]


def run_together(threads: Sequence[Iterator[object]]) -> None:
    """Run a block's threads to their ends.

    Raises
    ------
    PtxError
        If some wait for others that never come.
    """
    waiting = {i: next(thread, None) for i, thread in enumerate(threads)}
    while True:
        waiting = {i: at for i, at in waiting.items() if at is not None}
        if not waiting:
            return
        released = _meet(waiting)
        if not released:
            if any(at is not BARRIER for at in waiting.values()):
                raise PtxError("threads wait for others of their warp that do not come")
            released = list(waiting)
        for i in released:
            waiting[i] = next(threads[i], None)


def _meet(waiting: dict[int, Any]) -> list[int]:
    """Complete votes at which all threads have arrived; returns the threads that may continue."""
    groups: dict[Any, list[int]] = defaultdict(list)
    for i, at in waiting.items():
        if at is not BARRIER:
            place, meeting = at
            groups[i // WARP_SIZE, place, meeting.voters].append(i)
    released = []
    for (_, _, voters), members in groups.items():
        meetings = [waiting[i][1] for i in members]
        here = sum(1 << one.lane for one in meetings)
        if voters & ~here:
            continue
        for one in meetings:
            if voters and not voters >> one.lane & 1:
                raise PtxError("a thread votes that is not among the voters")
            one.answer(_outcome(one, meetings, here))
        released += members
    return released


def _outcome(own: Meeting, meetings: Sequence[Meeting], here: int) -> Any:
    if own.kind == "activemask":
        return here
    if own.kind == "match":
        return sum(1 << one.lane for one in meetings if one.value == own.value)
    yes = sum(1 << one.lane for one in meetings if one.value)
    return {"ballot": yes, "any": yes != 0, "all": yes == here}[own.kind]
