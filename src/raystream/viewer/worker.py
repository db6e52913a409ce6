"""Worker: time-slices rendering between connected clients."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Protocol

from raystream.viewer.fair_scheduler import FairScheduler

#: Time limit of a slice: for a single client, and while others wait.
_SLICE_ALONE, _SLICE_SHARED = 0.1, 0.04

#: A slice that exceeds this many seconds continues in parallel with the others' turns: it is
#: compiling, or cannot be divided. At most this many run so; further ones are waited for.
_OVERDUE_SECONDS, _MAX_OVERDUE = 0.25, 2

#: Polling interval, to notice cameras that have come to rest.
_POLL_SECONDS = 0.1


class RenderTask(Protocol):
    """A source of rendering work; implemented by `Client`."""

    def __hash__(self) -> int: ...

    def has_work(self) -> bool:
        """Whether there is work to do."""

    def step(self, seconds: float) -> None:
        """Render one slice within a time limit."""

    def release(self) -> None:
        """Free resources."""


class Worker:
    """A thread that gives turns to tasks with work, until it is closed.

    Slices of one task never overlap, and slices of different tasks rarely do.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._tasks: list[RenderTask] = []
        self._left: list[RenderTask] = []
        self._is_closed = self._is_woken = False
        # Accessed by the thread only.
        self._scheduler: FairScheduler[RenderTask] = FairScheduler()
        self._overdue: dict[Future[float], RenderTask] = {}
        self._pool = ThreadPoolExecutor(1 + _MAX_OVERDUE, "raystream viewer turn")
        self._thread = threading.Thread(target=self._run, name="raystream viewer", daemon=True)
        self._thread.start()

    @property
    def tasks(self) -> list[RenderTask]:
        """The current tasks."""
        with self._changed:
            return list(self._tasks)

    def add(self, task: RenderTask) -> bool:
        """Add a task; returns False if the worker is closed."""
        with self._changed:
            if not self._is_closed:
                self._tasks.append(task)
            return not self._is_closed

    def drop(self, task: RenderTask) -> None:
        """Remove a task."""
        with self._changed:
            if task in self._tasks:
                self._tasks.remove(task)
            self._left.append(task)
            self._changed.notify_all()

    def wake(self) -> None:
        """Check for work now."""
        with self._changed:
            self._is_woken = True
            self._changed.notify_all()

    def close(self, timeout: float = 10.0) -> None:
        """Stop the threads, after the slices in progress."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        self._thread.join(timeout)
        wait(list(self._overdue), timeout)
        self._pool.shutdown(wait=False)

    def _run(self) -> None:
        while True:
            with self._changed:
                if self._is_closed:
                    return
                self._is_woken = False
                tasks, left = list(self._tasks), list(self._left)
                self._left.clear()
            for turn in [turn for turn in self._overdue if turn.done()]:
                self._scheduler.charge(self._overdue.pop(turn), turn.result())
            busy = list(self._overdue.values())
            self._remove_left(left, busy)
            ready = [one for one in tasks if one not in busy and one.has_work()]
            if ready:
                self._take_turn(self._scheduler.choose(ready), len(ready) + len(busy))
                continue
            with self._changed:
                if not self._is_woken and not self._is_closed:
                    self._changed.wait(_POLL_SECONDS if tasks or self._left else None)

    def _remove_left(self, left: list[RenderTask], busy: list[RenderTask]) -> None:
        for task in left:
            if task in busy:  # retry later
                with self._changed:
                    self._left.append(task)
            else:
                task.release()
                self._scheduler.forget(task)

    def _take_turn(self, task: RenderTask, count: int) -> None:
        seconds = _SLICE_ALONE if count == 1 else _SLICE_SHARED
        turn = self._pool.submit(_timed_step, task, seconds)
        is_last = len(self._overdue) >= _MAX_OVERDUE
        done, _ = wait([turn], None if is_last else _OVERDUE_SECONDS)
        if done:
            self._scheduler.charge(task, turn.result())
        else:
            self._overdue[turn] = task
            turn.add_done_callback(lambda _: self.wake())


def _timed_step(task: RenderTask, seconds: float) -> float:
    """Run a slice; returns its duration in seconds."""
    started = time.perf_counter()
    task.step(seconds)
    return time.perf_counter() - started
