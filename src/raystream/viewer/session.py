"""Session: a client's scene and settings, and the tracers built for them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from raystream.viewer.browser_scene import browser_support
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Message, error_text
from raystream.viewer.scenes import LoadedScene, load_model
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import PreparedTracer, TracerCache


class Session:
    """The scene and settings of a client; the previous ones stay in effect during a build.

    Parameters
    ----------
    home : LoadedScene
        The scene shared by all clients.
    settings : Settings
        Initial settings.
    jobs : Jobs
        Runs the loading of models and the building of structures.
    send : callable
        Sends a message to the page.
    on_change : callable
        Called on any thread when something else is to be shown; with the scene if it has
        changed.

    Attributes
    ----------
    loaded : LoadedScene
    current : Settings and PreparedTracer or None
        Those in effect, and their tracer: None until it is built for the first time.
    """

    def __init__(
        self,
        home: LoadedScene,
        settings: Settings,
        jobs: Jobs,
        send: Callable[[Message], object],
        on_change: Callable[[LoadedScene | None], object],
    ) -> None:
        self._home, self._jobs = home, jobs
        self._send, self._on_change = send, on_change
        self._lock = threading.RLock()
        self._requested = settings
        self._wait: _Wait | None = None
        self._opening: Job | None = None
        self._is_over = False
        self.loaded = home
        self.current: tuple[Settings, PreparedTracer | None] = (settings, None)

    def show(self, loaded: LoadedScene) -> None:
        """Switch to a scene, keeping the settings."""
        with self._lock:
            if self._is_over:
                return
            self._stop_waiting()
            self.loaded, self.current = loaded, (self.current[0], None)
            self._send(loaded.message())
            self._on_change(loaded)
            self._request(self.current[0])

    def home(self) -> None:
        """Switch back to the shared scene."""
        with self._lock:
            self._cancel_opening()
            if self.loaded.is_own:
                self.show(self._home)

    def open(self, path: Path, name: str) -> None:
        """Load a model in the background, and switch to it."""

        def show(job: Job) -> None:
            loaded = load_model(path, name, self._jobs, job)
            with self._lock:
                if self._opening is job:
                    self._opening = None
                    self._send_progress_end()
                    self.show(loaded)

        def failed(reason: str) -> None:
            with self._lock:
                if self._opening is job:
                    self._opening = None
                    self._send_progress_end()
                    self._send({"type": "error", "message": reason, "about": "open"})

        job = Job(self._send_progress)
        with self._lock:
            if self._is_over:
                return
            self._cancel_opening()
            self._opening = job
        self._jobs.start(job, show, failed)

    def change(self, message: Mapping[str, Any]) -> None:
        """Switch to other settings, at once or when their tracer is built.

        Invalid settings are rejected, and change nothing.
        """
        with self._lock:
            if self._is_over:
                return
            try:
                requested = self._requested.changed(message)
            except ValueError as error:
                self._reject(error_text(error))
                return
            self._request(requested)

    def end(self) -> None:
        """Cancel pending work, and release everything it holds."""
        with self._lock:
            self._is_over = True
            self._cancel_opening()
            self._stop_waiting()
            self.loaded, self.current = self._home, (self.current[0], None)

    def _request(self, requested: Settings) -> None:
        self._stop_waiting()
        self._requested = requested
        tracers = self.loaded.tracers
        prepared = tracers.ready(requested)
        if prepared is not None:
            self._apply(requested, prepared)
            return
        if self.current[1] is None:
            self._send(requested.message())
        self._wait = _Wait(self, tracers, requested)
        tracers.request(requested, self._wait)

    def _apply(self, settings: Settings, prepared: PreparedTracer) -> None:
        before = self.current[1]
        is_other = before is None or before.key != prepared.key
        self.current = settings, prepared
        self._send(settings.message())
        if is_other:
            self.loaded.tracers.describe(
                prepared, lambda said: self._send(said | {"browser": browser_support(prepared)})
            )
        self._on_change(None)

    def _reject(self, reason: str) -> None:
        self._send(self.current[0].message() | {"refused": reason})

    def _stop_waiting(self) -> None:
        wait, self._wait = self._wait, None
        if wait is not None:
            wait.tracers.forget(wait)
            self._send_progress_end()

    def _cancel_opening(self) -> None:
        job, self._opening = self._opening, None
        if job is not None:
            job.cancel()
            self._send_progress_end()

    def _send_progress(self, what: str, done: float) -> None:
        self._send({"type": "progress", "what": what, "done": round(done, 4)})

    def _send_progress_end(self) -> None:
        self._send({"type": "progress", "what": "", "done": None})

    # Callbacks of `_Wait`.

    def _on_wait_progress(self, wait: _Wait, what: str, done: float) -> None:
        if self._wait is wait:
            self._send_progress(what, done)

    def _on_wait_ready(self, wait: _Wait, prepared: PreparedTracer) -> None:
        with self._lock:
            if self._wait is wait:
                self._wait = None
                self._send_progress_end()
                self._apply(wait.settings, prepared)

    def _on_wait_failure(self, wait: _Wait, reason: str) -> None:
        with self._lock:
            if self._wait is not wait:
                return
            self._wait = None
            self._send_progress_end()
            self._reject(reason)
            self._requested = self.current[0]
            if self.current[1] is None and self.loaded.is_own:  # the model cannot be shown
                self._send({"type": "error", "message": reason, "about": "open"})
                self.show(self._home)


class _Wait:
    """Waits for a tracer; implements `Waiter`."""

    def __init__(self, session: Session, tracers: TracerCache, settings: Settings) -> None:
        self._session = session
        self.tracers, self.settings = tracers, settings

    def on_progress(self, what: str, done: float) -> None:
        self._session._on_wait_progress(self, what, done)

    def on_ready(self, prepared: PreparedTracer) -> None:
        self._session._on_wait_ready(self, prepared)

    def on_failure(self, reason: str) -> None:
        self._session._on_wait_failure(self, reason)
