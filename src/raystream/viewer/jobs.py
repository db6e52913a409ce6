"""Jobs: long work beside the pictures, such as builds, which ends when nobody wants it any more."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from raystream.jit.threads import Progress
from raystream.viewer.messages import error_text
from raystream.viewer.pictures import BrokenOffError

__all__ = ["Job", "Jobs"]

#: Jobs that run at the same time; others wait.
_AT_ONCE = 4

#: Seconds between two reports of progress, and until a job that waits notices that it need not.
_REPORT_SECONDS = 0.1

#: Called with what is done, and how much of it, from 0 to 1.
Report = Callable[[str, float], object]


class Job:
    """Something long that can be broken off.

    Parameters
    ----------
    report : callable
        Called with what is being done, and how much of that, from 0 to 1.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._unwanted = threading.Event()

    def break_off(self) -> None:
        """End it soon; what it has done so far is dropped."""
        self._unwanted.set()

    @property
    def is_wanted(self) -> bool:
        """Whether it has not been broken off."""
        return not self._unwanted.is_set()

    def begin(self, what: str) -> Progress:
        """Say what is done next; returns the callback for its progress.

        Raises
        ------
        BrokenOffError
            Here and from the callback, if the job has been broken off.
        """
        self._go_on()
        self._report(what, 0.0)
        shown = time.monotonic()

        def progress(done: int, total: int) -> None:
            nonlocal shown
            self._go_on()
            now = time.monotonic()
            if now - shown >= _REPORT_SECONDS and total > 0:
                shown = now
                self._report(what, min(done / total, 1.0))

        return progress

    def _go_on(self) -> None:
        if self._unwanted.is_set():
            raise BrokenOffError


class Jobs:
    """Runs jobs on threads of their own."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._places = threading.BoundedSemaphore(_AT_ONCE)
        self._running: dict[Job, threading.Thread] = {}
        self._is_closed = False

    def start(
        self, job: Job, work: Callable[[Job], object], failed: Callable[[str], object]
    ) -> None:
        """Begin a job.

        Parameters
        ----------
        job : Job
        work : callable
            Is given the job, and ends by itself where it is broken off.
        failed : callable
            Called with a line of text if the work raises an error.
        """

        def run() -> None:
            try:
                while job.is_wanted:
                    if self._places.acquire(timeout=_REPORT_SECONDS):
                        try:
                            work(job)
                        finally:
                            self._places.release()
                        break
            except BrokenOffError:
                pass
            except Exception as error:  # whatever it is, the studio goes on
                if job.is_wanted:
                    failed(error_text(error))
            finally:
                with self._lock:
                    self._running.pop(job, None)

        with self._lock:
            if self._is_closed:
                return
            thread = threading.Thread(target=run, name="raystream viewer job", daemon=True)
            self._running[job] = thread
        thread.start()

    def close(self, timeout: float = 10.0) -> None:
        """Break all jobs off, and wait for them."""
        with self._lock:
            self._is_closed = True
            running = dict(self._running)
        for job in running:
            job.break_off()
        end = time.monotonic() + timeout
        for thread in running.values():
            thread.join(max(0.0, end - time.monotonic()))
