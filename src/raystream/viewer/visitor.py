"""Visitor: one page that looks at a scene; takes its messages and keeps what it wants."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raystream.viewer.encoding import MOVING_QUALITY, STILL_QUALITY, encode_jpeg
from raystream.viewer.jobs import Job
from raystream.viewer.messages import (
    Frame,
    Message,
    MessageError,
    Send,
    error_text,
    read_flag,
    read_whole,
)
from raystream.viewer.scenes import Staged, read_camera, stage
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import Prepared, Tracers
from raystream.viewer.view import Shot, View, Wish

if TYPE_CHECKING:
    from raystream.viewer.studio import Studio

__all__ = ["MAX_PIXELS", "MAX_SIDE", "MIN_SIDE", "Visitor"]

#: Sizes of a canvas, in pixels.
MIN_SIDE, MAX_SIDE, MAX_PIXELS = 16, 4096, 8_300_000

#: Frames that may be under way to the page, until it says that it has shown one.
_MOST_UNDER_WAY = 2

#: A page tells its size first thing; without it, pictures have the usual one after a moment.
_USUAL_SIZE, _SIZE_SECONDS = (1024, 768), 0.3

#: A camera that is said to move but does not for so long stands still.
_STILL_SECONDS = 1.0

_WHOLE = 1 << 53  # integers that a page can count


class Visitor:
    """One page that looks at a scene. `Studio.join` makes it.

    All methods may be called from any thread, and return at once.
    """

    def __init__(self, studio: Studio, send: Send, staged: Staged, settings: Settings) -> None:
        self._studio, self._send = studio, send
        self._lock = threading.RLock()
        self._staged = staged
        self._asked = self._settings = settings
        self._prepared: Prepared | None = None
        self._wait: _Wait | None = None
        self._opening: Job | None = None
        self._camera, self._number = staged.scene.camera, 0
        self._moving, self._moved_at = False, 0.0
        self._size: tuple[int, int] | None = None
        self._joined_at = time.monotonic()
        self._paused = self._has_left = False
        self._sent = self._shown = 0
        self._encoding = 0
        self._held: Shot | None = None
        self._failed: Wish | None = None
        self.view = View(self._take_shot)

    # Messages.

    def take(self, message: Any) -> None:
        """Take a message of the page.

        Parameters
        ----------
        message : dict
            A JSON object. One that cannot be used is answered by an ``"error"``, and changes
            nothing.
        """
        about = message.get("type") if isinstance(message, dict) else None
        take = _TAKERS.get(about) if isinstance(about, str) else None
        try:
            if take is None:
                known = ", ".join(map(repr, _TAKERS))
                raise MessageError(f"type: expected one of {known}, got {about!r:.40}")
            with self._lock:
                if self._has_left:
                    return
                take(self, message)
        except MessageError as error:
            self.tell({"type": "error", "message": str(error), "about": f"{about!s:.40}"})
        self._studio.wake()

    def _take_camera(self, message: Message) -> None:
        number = read_whole(message, "number", 0, _WHOLE)
        moving = read_flag(message, "moving")
        self._camera, self._number, self._moving = read_camera(message), number, moving
        self._moved_at = time.monotonic()

    def _take_size(self, message: Message) -> None:
        width = read_whole(message, "width", MIN_SIDE, MAX_SIDE)
        height = read_whole(message, "height", MIN_SIDE, MAX_SIDE)
        if width * height > MAX_PIXELS:
            raise MessageError(
                f"size: expected at most {MAX_PIXELS:,} pixels, got {width}x{height}"
            )
        self._size = width, height

    def _take_settings(self, message: Message) -> None:
        try:
            asked = self._asked.changed(message)
            asked.mode_options  # noqa: B018 checks them
        except ValueError as error:
            self.tell(self._settings.message() | {"refused": error_text(error)})
            return
        self._ask(asked)

    def _take_shown(self, message: Message) -> None:
        self._shown = max(self._shown, read_whole(message, "frame", 1, max(self._sent, 1)))

    def _take_pause(self, message: Message) -> None:
        self._paused = read_flag(message, "paused")

    def _take_home(self, message: Message) -> None:
        del message
        self._stop_opening()
        if self._staged.is_own:
            self._enter(self._studio.home)

    # Scenes and settings.

    def begin(self) -> None:
        """Tell the page what there is, and prepare the first picture."""
        with self._lock:
            self._enter(self._staged)

    def open(self, path: Path, name: str) -> None:
        """Load a model as this visitor's own scene, and show it instead of the present one.

        Parameters
        ----------
        path : Path
            A file, which may go when the visitor has left.
        name : str
            What to call it.
        """

        def enter(job: Job) -> None:
            staged = stage(path, name, self._studio.jobs, job)
            with self._lock:
                if job is self._opening and not self._has_left:
                    self._opening = None
                    self._enter(staged)
            self._studio.wake()

        def failed(reason: str) -> None:
            self._end_progress()
            self.tell({"type": "error", "message": reason, "about": "open"})

        job = Job(self._tell_progress)
        with self._lock:
            if self._has_left:
                return
            self._stop_opening()
            self._opening = job
        self._studio.jobs.start(job, enter, failed)

    def _stop_opening(self) -> None:
        if self._opening is not None:
            self._opening.break_off()
            self._opening = None

    def _enter(self, staged: Staged) -> None:
        self._forget_wait()
        self._staged, self._prepared, self._failed = staged, None, None
        self._camera, self._number, self._moving = staged.scene.camera, 0, False
        self.tell(staged.message())
        asked, self._asked = self._asked, self._settings
        self._ask(asked)

    def _ask(self, asked: Settings) -> None:
        """Go over to other settings, at once or when they are prepared."""
        self._asked, self._failed = asked, None
        self._forget_wait()
        tracers = self._staged.tracers
        prepared = tracers.ready(asked)
        if prepared is not None:
            self._go_over(asked, prepared)
            return
        if self._prepared is None:
            self.tell(asked.message())
        self._wait = _Wait(self, tracers, asked)
        tracers.want(asked, self._wait)

    def _forget_wait(self) -> None:
        wait, self._wait = self._wait, None
        if wait is not None:
            wait.tracers.forget(wait)
            self._end_progress()

    def _tell_progress(self, what: str, done: float) -> None:
        self.tell({"type": "progress", "what": what, "done": round(done, 4)})

    def _end_progress(self) -> None:
        self.tell({"type": "progress", "what": "", "done": None})

    def _go_over(self, settings: Settings, prepared: Prepared) -> None:
        is_other = prepared is not self._prepared
        self._settings, self._prepared = settings, prepared
        self.tell(settings.message())
        if is_other:
            self._staged.tracers.describe(prepared, self.tell)

    def on_progress(self, wait: _Wait, what: str, done: float) -> None:
        """Tell the page how far a build is."""
        if self._wait is wait:
            self._tell_progress(what, done)

    def on_ready(self, wait: _Wait, prepared: Prepared) -> None:
        """Use a tracer that was waited for."""
        with self._lock:
            if self._wait is wait and not self._has_left:
                self._wait = None
                self._end_progress()
                self._go_over(wait.settings, prepared)
        self._studio.wake()

    def on_failure(self, wait: _Wait, reason: str) -> None:
        """Stay with the last good settings."""
        with self._lock:
            if self._wait is not wait or self._has_left:
                return
            self._wait = None
            self._end_progress()
            self.tell(self._settings.message() | {"refused": reason})
            if self._prepared is None and self._staged.is_own:  # nothing of it can be shown
                self.tell({"type": "error", "message": reason, "about": "open"})
                self._enter(self._studio.home)
            else:
                self._asked = self._settings

    # Pictures.

    def wish(self) -> Wish | None:
        """What the visitor wants to see now; None if nothing."""
        with self._lock:
            prepared, size = self._prepared, self._size
            if self._has_left or self._paused or prepared is None:
                return None
            now = time.monotonic()
            if size is None:
                if now < self._joined_at + _SIZE_SECONDS:
                    return None
                size = _USUAL_SIZE
            moving = self._moving and now < self._moved_at + _STILL_SECONDS
            return Wish(prepared, self._settings, self._camera, self._number, size, moving)

    def has_work(self) -> bool:
        """Whether the worker has anything to do for it."""
        with self._lock:
            if self._held is not None or self._sent - self._shown >= _MOST_UNDER_WAY:
                return False
            wish = self.wish()
        if wish is None or (self._failed is not None and self._failed.sight == wish.sight):
            return False
        return self.view.has_work(wish)

    def step(self, seconds: float) -> None:
        """Do a slice of its work, on the worker's thread."""
        wish = self.wish()
        if wish is None:
            return
        try:
            self.view.step(wish, seconds, self._is_wanted)
        except Exception as error:  # the others' pictures go on
            self.view.forget()
            self._failed = wish
            self.tell({"type": "error", "message": error_text(error), "about": "frame"})

    def _is_wanted(self, view: View) -> bool:
        wish = self.wish()
        return wish is not None and view.is_worth(wish)

    def _take_shot(self, shot: Shot) -> None:
        """Encode a picture, or hold it back until the one before is encoded."""
        with self._lock:
            if self._encoding:
                if shot.header["moving"] or shot.header["done"] or shot.header["samples"] == 1:
                    self._held = shot
                return
            self._encoding = 1
            self._sent += 1
            shot.header["number"] = self._sent
        self._encode(shot)

    def _encode(self, shot: Shot) -> None:
        quality = MOVING_QUALITY if shot.header["moving"] else STILL_QUALITY
        shot.header["format"] = "image/jpeg"
        self._studio.encoder.encode(
            lambda: encode_jpeg(shot.pixels, shot.look, quality),
            shot.header,
            self._on_encoded,
            self._on_not_encoded,
        )

    def _on_encoded(self, frame: Frame) -> None:
        self.tell(frame)
        self._go_on_encoding()

    def _on_not_encoded(self, error: Exception) -> None:
        self.tell({"type": "error", "message": error_text(error), "about": "frame"})
        with self._lock:
            self._shown = max(self._shown, self._sent)  # nobody will say that it was shown
        self._go_on_encoding()

    def _go_on_encoding(self) -> None:
        with self._lock:
            shot, self._held = self._held, None
            self._encoding = 0
        if shot is not None:
            self._take_shot(shot)
        self._studio.wake()

    # The end.

    def tell(self, message: Message | Frame) -> None:
        """Send the page something; a page that cannot be reached has left."""
        if self._has_left:
            return
        try:
            self._send(message)
        except Exception:
            self.leave()

    def leave(self) -> None:
        """End all that is done for it, and drop what is its own."""
        with self._lock:
            if self._has_left:
                return
            self._has_left = True
            self._stop_opening()
            if self._wait is not None:
                self._wait.tracers.forget(self._wait)
            self._wait = self._prepared = self._held = None
        self._studio.drop(self)


class _Wait:
    """A visitor's wait for a tracer."""

    def __init__(self, visitor: Visitor, tracers: Tracers, settings: Settings) -> None:
        self.visitor, self.tracers, self.settings = visitor, tracers, settings

    def on_progress(self, what: str, done: float) -> None:
        self.visitor.on_progress(self, what, done)

    def on_ready(self, prepared: Prepared) -> None:
        self.visitor.on_ready(self, prepared)

    def on_failure(self, reason: str) -> None:
        self.visitor.on_failure(self, reason)


_TAKERS: dict[str, Callable[[Visitor, Message], None]] = {
    "camera": Visitor._take_camera,
    "size": Visitor._take_size,
    "settings": Visitor._take_settings,
    "shown": Visitor._take_shown,
    "pause": Visitor._take_pause,
    "home": Visitor._take_home,
}
