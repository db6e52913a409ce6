"""Thread budget: divides a worker's threads among its running tasks.

Dask runs as many tasks at a time as a worker has threads, and raystream runs each query on
several threads. Together they must not exceed the worker's threads.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
from collections.abc import Iterator

from distributed import get_worker

from raystream.jit.threads import set_thread_count, thread_count

_lock = threading.Lock()
_numbers = itertools.count()

#: Tasks running in this process: the worker of each, and its threads.
_running: dict[int, tuple[int, int]] = {}

#: Thread count of this process before the first task.
_before = 0


@contextlib.contextmanager
def shared_threads() -> Iterator[None]:
    """Trace with the worker's threads, divided among the tasks it is running.

    A single task gets all threads; with as many tasks as threads, each gets one. Running
    tasks adopt their smaller share at their next query. In a process without a worker, tasks
    divide the process's threads.
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
        _divide()
    try:
        yield
    finally:
        with _lock:
            del _running[number]
            _divide()


def _divide() -> None:
    """Set the thread count of each task; the caller holds the lock."""
    if not _running:
        set_thread_count(_before)
        return
    workers = dict(_running.values())
    total = sum(workers.values()) or _before
    set_thread_count(max(1, total // len(_running)))
