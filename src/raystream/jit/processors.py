"""Which processors a loop's helping threads may run on: any but that of the thread they help.

Linux may wake a thread on the processor of the thread that wakes it, although another is idle: in
a virtual machine an idle processor counts as taken once its host has lent it to others. The two
then share one processor until a timer of the kernel moves one of them, about 10 ms later, which is
longer than most queries take: camera rays on the bunny, 0.3 s after the last query, took 14.7 ms,
now 9.1 (decision 0041).
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Callable


def _find_getcpu() -> Callable[[], int] | None:
    """The C library's `sched_getcpu`, where the system has it and threads can be bound."""
    if not sys.platform.startswith("linux") or not hasattr(os, "sched_setaffinity"):
        return None
    try:
        found: Callable[[], int] = ctypes.CDLL(None).sched_getcpu
    except (OSError, AttributeError):
        return None
    return found


current_processor = _find_getcpu()


class Helpers:
    """Threads of a pool, and where they may run."""

    def __init__(self) -> None:
        self._threads: list[int] = []
        self._bound: tuple[int, set[int], int] | None = None

    def add_current_thread(self) -> None:
        """Add a thread: called on each one when it starts."""
        self._threads.append(threading.get_native_id())

    def keep_off_this_processor(self) -> None:
        """Let the threads run on the caller's processors, without the one that it runs on now.

        Does nothing if the caller has one processor only, or the system does not tell.
        """
        if current_processor is None:
            return
        here = current_processor()
        allowed = os.sched_getaffinity(0)
        now = here, allowed, len(self._threads)
        others = allowed - {here}
        if now == self._bound or not others:
            return
        for thread in list(self._threads):
            with contextlib.suppress(OSError):  # not permitted here, or the thread has ended
                os.sched_setaffinity(thread, others)
        self._bound = now
