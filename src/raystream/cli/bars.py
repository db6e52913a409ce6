"""Progress bars, shown only on an interactive stderr."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

#: Seconds of work before a bar appears.
DELAY = 1.0


class Step:
    """Progress callback of a step: called with (done, total).

    Parameters
    ----------
    progress : rich.progress.Progress
    title : str
    unit : str
    """

    def __init__(self, progress: RichProgress, title: str, unit: str) -> None:
        self._progress = progress
        self._title = title
        self._task = progress.add_task(title, total=None, unit=unit)

    def __call__(self, done: int, total: int) -> None:
        """Report progress."""
        self._progress.update(self._task, completed=done, total=total)

    def describe(self, state: str) -> None:
        """Show a state behind the title, such as "error 3.20%"."""
        self._progress.update(self._task, description=f"{self._title}, {state}")

    def remove(self) -> None:
        """Remove the step from the screen."""
        self._progress.remove_task(self._task)


class Bars:
    """Shows a command's current step on a terminal, once it has run for a second.

    A context manager; it clears the bars from the screen on exit.
    """

    def __init__(self) -> None:
        self._progress: RichProgress | None = None
        self._lock = threading.Lock()
        self._is_over = False
        if sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
            self._progress = _make_progress()
        self._timer = threading.Timer(DELAY, self._show)
        self._timer.daemon = True

    def __enter__(self) -> Bars:
        if self._progress is not None:
            self._timer.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._timer.cancel()
        with self._lock:
            self._is_over = True
            if self._progress is not None:
                self._progress.stop()

    def _show(self) -> None:
        with self._lock:
            if self._progress is not None and not self._is_over:
                self._progress.start()

    @contextlib.contextmanager
    def step(self, title: str, unit: str = "") -> Iterator[Step | None]:
        """Show a step during the block.

        Parameters
        ----------
        title : str
            Such as "tracing".
        unit : str, optional
            Unit of the count, such as "rays": shows the speed in millions per second.

        Yields
        ------
        Step or None
            Until it is called, the step shows a spinner. None if stderr is not interactive.
        """
        progress = self._progress
        if progress is None:
            yield None
            return
        step = Step(progress, title, unit)
        try:
            yield step
        finally:
            step.remove()


def _make_progress() -> RichProgress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        ProgressColumn,
        SpinnerColumn,
        Task,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class SpeedColumn(ProgressColumn):
        """Speed in millions of units per second."""

        def render(self, task: Task) -> Text:
            unit = task.fields["unit"]
            if not unit or task.speed is None:
                return Text("")
            return Text(f"{task.speed / 1e6:.2f} M{unit}/s")

    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}", markup=False),  # no markup or emoji codes
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        SpeedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
