"""Jobs: long background work, such as builds, that can be cancelled."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from raystream.jit.threads import Progress
from raystream.viewer.messages import error_text
from raystream.viewer.progressive_images import WorkCancelledError

#: Maximum jobs that run at the same time; others wait.
_MAX_RUNNING = 4

#: Seconds between progress reports, and between a waiting job's checks for cancellation.
_REPORT_SECONDS = 0.1

#: Called with the current activity, and its progress from 0 to 1.
Report = Callable[[str, float], object]


class Job:
    """A piece of background work that can be cancelled.

    Parameters
    ----------
    report : callable
        Called with the current activity, and its progress from 0 to 1.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._cancelled = threading.Event()

    def cancel(self) -> None:
        """Cancel the job; it ends soon, and its results are discarded."""
        self._cancelled.set()

    @property
    def is_wanted(self) -> bool:
        """Whether the job has not been cancelled."""
        return not self._cancelled.is_set()

    def begin(self, what: str) -> Progress:
        """Report the next activity; returns the callback for its progress.

        Raises
        ------
        WorkCancelledError
            Here and from the callback, if the job has been cancelled.
        """
        self._check_cancelled()
        self._report(what, 0.0)
        shown = time.monotonic()

        def progress(done: int, total: int) -> None:
            nonlocal shown
            self._check_cancelled()
            now = time.monotonic()
            if now - shown >= _REPORT_SECONDS and total > 0:
                shown = now
                self._report(what, min(done / total, 1.0))

        return progress

    def _check_cancelled(self) -> None:
        if self._cancelled.is_set():
            raise WorkCancelledError


class Jobs:
    """Runs each job on its own thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._places = threading.BoundedSemaphore(_MAX_RUNNING)
        self._running: dict[Job, threading.Thread] = {}
        self._is_closed = False

    def start(
        self, job: Job, work: Callable[[Job], object], failed: Callable[[str], object]
    ) -> None:
        """Start a job.

        Parameters
        ----------
        job : Job
        work : callable
            Called with the job; checks for cancellation itself.
        failed : callable
            Called with a one-line message if the work raises an error.
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
            except WorkCancelledError:
                pass
            except Exception as error:  # of any kind: the service must continue
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
        """Cancel all jobs, and wait for them."""
        with self._lock:
            self._is_closed = True
            running = dict(self._running)
        for job in running:
            job.cancel()
        end = time.monotonic() + timeout
        for thread in running.values():
            thread.join(max(0.0, end - time.monotonic()))
