"""The first use of a command on a machine: its kernels are compiled, on several cores."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

from raystream.cli.messages import write_note
from raystream.core.cache_folder import cache_folder
from raystream.jit.threads import thread_count
from raystream.jit.watching import watch

__all__ = ["compiling"]

#: Seconds of compilation after which the user is told.
DELAY = 1.0

#: Processes that help: a command's kernels keep no more busy.
MOST_HELPERS = 3


@contextlib.contextmanager
def compiling(task: str, structure: str | None, device: str) -> Iterator[None]:
    """While the block runs, say what is compiled if that takes more than a second.

    The first kernel that is missing starts processes that compile the rest of the task's kernels,
    from the end of the list, while this one works from its beginning.

    Parameters
    ----------
    task : str
        Of `jit.warm.TASKS`, or a part of one.
    structure, device : str or None
        Other ones than the default have other kernels, which are compiled here as they are needed.
    """
    is_listed = structure in (None, "bvh") and device == "cpu"
    first_use = _FirstUse(task if is_listed else None)
    try:
        with watch(first_use):
            yield
    finally:
        first_use.stop()


class _FirstUse:
    """Watches what is compiled; see `jit.watching.Watcher`."""

    def __init__(self, task: str | None) -> None:
        self._task = task
        self._helpers: list[Any] = []
        self._lock = threading.Lock()
        self._has_begun = False
        self._seconds = 0.0
        self._has_told = False

    def begin(self, kernel: str) -> None:  # noqa: ARG002 - a watcher's
        with self._lock:
            if self._has_begun:
                return
            self._has_begun = True
            count = min(thread_count() - 1, MOST_HELPERS)
            if self._task is not None and count > 0:
                from raystream.jit.warm import start_helpers

                with contextlib.suppress(OSError):  # no more processes: this one does it alone
                    self._helpers = start_helpers(self._task, count, longest_first=False)

    def end(self, kernel: str, seconds: float) -> None:  # noqa: ARG002 - a watcher's
        with self._lock:
            self._seconds += seconds
            is_time = self._seconds > DELAY and not self._has_told
            self._has_told = self._has_told or is_time
        if is_time:
            write_note(
                "compiling kernels on their first use, which takes some seconds; "
                f"they are kept in {cache_folder()}"
            )

    def stop(self) -> None:
        """End the helpers: the command needs nothing more."""
        if self._helpers:
            from raystream.jit.warm import stop_helpers

            stop_helpers(self._helpers)
