"""Shares: how many of a worker's threads each of its tasks gets.

Dask runs as many tasks at a time as a worker has threads, and raystream spreads each query over
threads of its own. Together they must not be more than the worker was given.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Iterator

from distributed import get_worker

from raystream.jit.threads import set_thread_count, thread_count

__all__ = ["own_share"]

_lock = threading.Lock()
_numbers = itertools.count()

#: Tasks that run in this process: the worker of each, and its threads.
_running: dict[int, tuple[int, int]] = {}

#: What this process had before the first of them.
_before = 0


@contextlib.contextmanager
def own_share() -> Iterator[None]:
    """Trace with the worker's threads, shared among the tasks that it runs now.

    One task alone has them all; as many tasks as threads have one each. Tasks that run
    already take their smaller share from their next query on. In a process without a worker,
    they share what it has.
    """
    number = next(_numbers)
    try:
        worker = get_worker()
        own = id(worker), max(1, int(worker.state.nthreads))
    except ValueError:
        own = 0, 0
    with _lock:
        global _before
        if not _running:
            _before = thread_count()
        _running[number] = own
        _share()
    try:
        yield
    finally:
        with _lock:
            del _running[number]
            _share()


def _share() -> None:
    """Say how many threads each has; the lock is held."""
    if not _running:
        set_thread_count(_before)
        return
    workers = dict(_running.values())
    total = sum(workers.values()) or _before
    set_thread_count(max(1, total // len(_running)))
