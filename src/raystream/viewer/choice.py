"""Choice: the scene and the settings of a visitor, and what has to be built for them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Message, error_text
from raystream.viewer.scenes import Staged, stage
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import Prepared, Tracers

__all__ = ["Choice"]


class Choice:
    """What a visitor has chosen to see, and sees until other things are built.

    Parameters
    ----------
    home : Staged
        The scene that everybody sees at first.
    settings : Settings
        To begin with.
    jobs : Jobs
        Where models are loaded and structures are built.
    tell : callable
        Sends a message to the page.
    on_change : callable
        Called, on any thread, when there is something else to see; with the scene if it is
        another one.

    Attributes
    ----------
    staged : Staged
    current : Settings and Prepared or None
        Those in effect, and what they need: None until it is built for the first time.
    """

    def __init__(
        self,
        home: Staged,
        settings: Settings,
        jobs: Jobs,
        tell: Callable[[Message], object],
        on_change: Callable[[Staged | None], object],
    ) -> None:
        self._home, self._jobs = home, jobs
        self._tell, self._on_change = tell, on_change
        self._lock = threading.RLock()
        self._asked = settings
        self._wait: _Wait | None = None
        self._opening: Job | None = None
        self._is_over = False
        self.staged = home
        self.current: tuple[Settings, Prepared | None] = (settings, None)

    def enter(self, staged: Staged) -> None:
        """Go to a scene, with the settings as they are."""
        with self._lock:
            if self._is_over:
                return
            self._stop_waiting()
            self.staged, self.current = staged, (self.current[0], None)
            self._tell(staged.message())
            self._on_change(staged)
            self._ask(self.current[0])

    def home(self) -> None:
        """Go back to the scene that everybody sees."""
        with self._lock:
            self._stop_opening()
            if self.staged.is_own:
                self.enter(self._home)

    def open(self, path: Path, name: str) -> None:
        """Load a model beside other work, and go to it."""

        def enter(job: Job) -> None:
            staged = stage(path, name, self._jobs, job)
            with self._lock:
                if self._opening is job:
                    self._opening = None
                    self._tell_end()
                    self.enter(staged)

        def failed(reason: str) -> None:
            with self._lock:
                if self._opening is job:
                    self._opening = None
                    self._tell_end()
                    self._tell({"type": "error", "message": reason, "about": "open"})

        job = Job(self._tell_progress)
        with self._lock:
            if self._is_over:
                return
            self._stop_opening()
            self._opening = job
        self._jobs.start(job, enter, failed)

    def change(self, message: Mapping[str, Any]) -> None:
        """Go over to other settings, at once or when what they need is built.

        Those that cannot be had are refused, and change nothing.
        """
        with self._lock:
            if self._is_over:
                return
            try:
                asked = self._asked.changed(message)
            except ValueError as error:
                self._refuse(error_text(error))
                return
            self._ask(asked)

    def end(self) -> None:
        """Break off what is being built for it, and drop what it has."""
        with self._lock:
            self._is_over = True
            self._stop_opening()
            self._stop_waiting()
            self.staged, self.current = self._home, (self.current[0], None)

    def _ask(self, asked: Settings) -> None:
        self._stop_waiting()
        self._asked = asked
        tracers = self.staged.tracers
        prepared = tracers.ready(asked)
        if prepared is not None:
            self._go_over(asked, prepared)
            return
        if self.current[1] is None:
            self._tell(asked.message())
        self._wait = _Wait(self, tracers, asked)
        tracers.want(asked, self._wait)

    def _go_over(self, settings: Settings, prepared: Prepared) -> None:
        before = self.current[1]
        is_other = before is None or before.key != prepared.key
        self.current = settings, prepared
        self._tell(settings.message())
        if is_other:
            self.staged.tracers.describe(prepared, self._tell)
        self._on_change(None)

    def _refuse(self, reason: str) -> None:
        self._tell(self.current[0].message() | {"refused": reason})

    def _stop_waiting(self) -> None:
        wait, self._wait = self._wait, None
        if wait is not None:
            wait.tracers.forget(wait)
            self._tell_end()

    def _stop_opening(self) -> None:
        job, self._opening = self._opening, None
        if job is not None:
            job.break_off()
            self._tell_end()

    def _tell_progress(self, what: str, done: float) -> None:
        self._tell({"type": "progress", "what": what, "done": round(done, 4)})

    def _tell_end(self) -> None:
        self._tell({"type": "progress", "what": "", "done": None})

    # What a `_Wait` hears.

    def _heard_progress(self, wait: _Wait, what: str, done: float) -> None:
        if self._wait is wait:
            self._tell_progress(what, done)

    def _heard_ready(self, wait: _Wait, prepared: Prepared) -> None:
        with self._lock:
            if self._wait is wait:
                self._wait = None
                self._tell_end()
                self._go_over(wait.settings, prepared)

    def _heard_failure(self, wait: _Wait, reason: str) -> None:
        with self._lock:
            if self._wait is not wait:
                return
            self._wait = None
            self._tell_end()
            self._refuse(reason)
            self._asked = self.current[0]
            if self.current[1] is None and self.staged.is_own:  # nothing of it can be shown
                self._tell({"type": "error", "message": reason, "about": "open"})
                self.enter(self._home)


class _Wait:
    """Waits for a tracer; see `Waiter`."""

    def __init__(self, choice: Choice, tracers: Tracers, settings: Settings) -> None:
        self._choice = choice
        self.tracers, self.settings = tracers, settings

    def on_progress(self, what: str, done: float) -> None:
        self._choice._heard_progress(self, what, done)

    def on_ready(self, prepared: Prepared) -> None:
        self._choice._heard_ready(self, prepared)

    def on_failure(self, reason: str) -> None:
        self._choice._heard_failure(self, reason)
