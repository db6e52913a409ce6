"""Visitor: one page that looks at a scene; takes its messages and keeps what it wants."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from raystream.viewer.asides import Picks, send_screenshot
from raystream.viewer.choice import Choice
from raystream.viewer.encoding import Encoder
from raystream.viewer.jobs import Jobs
from raystream.viewer.messages import (
    Message,
    MessageError,
    Send,
    error_text,
    read_flag,
    read_whole,
)
from raystream.viewer.outbox import Outbox
from raystream.viewer.picking import pixel_ray
from raystream.viewer.scenes import Staged, read_camera
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import device_is_free, device_lock
from raystream.viewer.view import View, Wish

__all__ = ["MAX_NUMBER", "MAX_PIXELS", "MAX_SIDE", "MIN_SIDE", "Crew", "Visitor"]

#: Sizes of a canvas, in pixels.
MIN_SIDE, MAX_SIDE, MAX_PIXELS = 16, 4096, 8_300_000

#: Numbers of messages: integers that a page can count to.
MAX_NUMBER = 1 << 53

#: A page tells its size first thing; without it, pictures have the usual one after a moment.
_USUAL_SIZE, _SIZE_SECONDS = (1024, 768), 0.3

#: A camera that is said to move but does not for so long stands still.
_STILL_SECONDS = 1.0


class Crew:
    """Who works for all visitors of a studio.

    Parameters
    ----------
    wake : callable
        Lets the worker look for work.

    Attributes
    ----------
    encoder : Encoder
    builds : Jobs
        What takes long.
    asides : Jobs
        What is soon done, and does not wait for builds.
    """

    def __init__(self, wake: Callable[[], object]) -> None:
        self.wake = wake
        self.encoder = Encoder()
        self.builds, self.asides = Jobs(), Jobs()

    def close(self) -> None:
        """End all threads."""
        self.builds.close()
        self.asides.close()
        self.encoder.close()


class Visitor:
    """One page that looks at a scene. `Studio.join` makes it.

    All methods may be called from any thread; those for the server return at once.
    """

    def __init__(
        self,
        crew: Crew,
        send: Send,
        home: Staged,
        settings: Settings,
        on_leave: Callable[[Visitor], object],
    ) -> None:
        self._crew, self._on_leave = crew, on_leave
        self._lock = threading.RLock()
        self._outbox = Outbox(send, crew.encoder, crew.wake, self.leave)
        self.tell = self._outbox.tell
        self._choice = Choice(home, settings, crew.builds, self.tell, self._on_change)
        self._picks = Picks(crew.asides, self.tell)
        self._view = View(self._outbox.put)
        self._camera, self._number = home.scene.camera, 0
        self._moving, self._moved_at = False, 0.0
        self._size: tuple[int, int] | None = None
        self._joined_at = time.monotonic()
        self._paused = self._has_left = False
        self._screenshot: int | None = None
        self._is_filing = False
        self._failed: Wish | None = None

    def begin(self) -> None:
        """Tell the page what there is, and prepare the first picture."""
        self._choice.enter(self._choice.staged)

    @property
    def has_left(self) -> bool:
        """Whether it is gone."""
        return self._has_left

    # For the server.

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
            if not self._has_left:
                take(self, message)
        except MessageError as error:
            self.tell({"type": "error", "message": str(error), "about": f"{about!s:.40}"})
        self._crew.wake()

    def open(self, path: Path, name: str) -> None:
        """Load a model as this visitor's own scene, and show it when it is there.

        Parameters
        ----------
        path : Path
            A file; it and what it refers to must stay until the visitor has left.
        name : str
            What to call it.
        """
        self._choice.open(path, name)

    def leave(self) -> None:
        """End all that is done for it, and drop what is its own."""
        with self._lock:
            if self._has_left:
                return
            self._has_left = True
        self._outbox.close()
        self._choice.end()
        self._picks.end()
        self._on_leave(self)

    # For the worker.

    def has_work(self) -> bool:
        """Whether the worker has anything to do for it."""
        wish = self._wish()
        if wish is None or not device_is_free(wish.prepared.key.device):
            return False
        if self._screenshot is not None:
            return True
        if self._failed is not None and self._failed.sight == wish.sight:
            return False
        return self._outbox.has_room and self._view.has_work(wish)

    def step(self, seconds: float) -> None:
        """Do a slice of its work.

        Parameters
        ----------
        seconds : float
            What it may take.
        """
        wish = self._wish()
        if wish is None:
            return
        try:
            with device_lock(wish.prepared.key.device):
                if self._screenshot is not None and self._take_screenshot(wish):
                    return
                self._view.step(wish, seconds, self._is_wanted)
        except Exception as error:  # whatever it is, the others' pictures go on
            self._view.forget()
            self._failed = wish
            about = "frame" if self._screenshot is None else "screenshot"
            self._screenshot = None
            self.tell({"type": "error", "message": error_text(error), "about": about})

    def rest(self) -> None:
        """Drop what was rendered for a visitor who has left."""
        self._view.forget()

    def _wish(self) -> Wish | None:
        """What it wants to see now; None if nothing."""
        with self._lock:
            choice, now = self._choice, time.monotonic()
            wants_file = self._screenshot is not None
            settings, prepared = choice.current
            if self._has_left or prepared is None or (self._paused and not wants_file):
                return None
            size = self._size
            if size is None:
                if now < self._joined_at + _SIZE_SECONDS:
                    return None
                size = _USUAL_SIZE
            moving = self._moving and now < self._moved_at + _STILL_SECONDS and not wants_file
            return Wish(prepared, settings, self._camera, self._number, size, moving)

    def _is_wanted(self) -> bool:
        wish = self._wish()
        return wish is not None and self._view.is_worth(wish)

    def _take_screenshot(self, wish: Wish) -> bool:
        """Send what is shown as a file, once there is a picture in full size."""
        picture = self._view.whole(wish)
        if picture is None:
            return False
        with self._lock:
            number, self._screenshot = self._screenshot, None
            self._is_filing = True
        header = self._view.header(picture, wish)
        header |= {"type": "screenshot", "number": number}
        draw = picture.draw_whole(wish.settings.look)
        send_screenshot(draw, header, self._crew.asides, self.tell, self._end_filing)
        return True

    def _end_filing(self) -> None:
        with self._lock:
            self._is_filing = False

    def _on_change(self, staged: Staged | None) -> None:
        with self._lock:
            self._failed = None
            if staged is not None:
                self._camera, self._number, self._moving = staged.scene.camera, 0, False
        self._crew.wake()

    # Messages.

    def _take_camera(self, message: Message) -> None:
        number = read_whole(message, "number", 0, MAX_NUMBER)
        moving = read_flag(message, "moving")
        camera = read_camera(message)
        with self._lock:
            self._camera, self._number, self._moving = camera, number, moving
            self._moved_at = time.monotonic()

    def _take_size(self, message: Message) -> None:
        width = read_whole(message, "width", MIN_SIDE, MAX_SIDE)
        height = read_whole(message, "height", MIN_SIDE, MAX_SIDE)
        if width * height > MAX_PIXELS:
            got = f"{width}x{height}"
            raise MessageError(f"size: expected at most {MAX_PIXELS:,} pixels, got {got}")
        with self._lock:
            self._size = width, height

    def _take_settings(self, message: Message) -> None:
        self._choice.change(message)

    def _take_pick(self, message: Message) -> None:
        with self._lock:
            camera, size = self._camera, self._size or _USUAL_SIZE
            _, prepared = self._choice.current
        ray = pixel_ray(message, camera, size)
        if prepared is None:
            raise MessageError("pick: there is nothing to pick yet")
        self._picks.ask(prepared.tracer, ray)

    def _take_shown(self, message: Message) -> None:
        self._outbox.acknowledge(read_whole(message, "frame", 1, MAX_NUMBER))

    def _take_file(self, message: Message) -> None:
        number = read_whole(message, "number", 0, MAX_NUMBER)
        with self._lock:
            if self._screenshot is not None or self._is_filing:
                raise MessageError("screenshot: the one before is not ready yet")
            self._screenshot = number

    def _take_pause(self, message: Message) -> None:
        paused = read_flag(message, "paused")
        with self._lock:
            self._paused = paused

    def _take_home(self, message: Message) -> None:
        del message
        self._choice.home()


_TAKERS: dict[str, Callable[[Visitor, Message], None]] = {
    "camera": Visitor._take_camera,
    "size": Visitor._take_size,
    "settings": Visitor._take_settings,
    "pick": Visitor._take_pick,
    "shown": Visitor._take_shown,
    "screenshot": Visitor._take_file,
    "pause": Visitor._take_pause,
    "home": Visitor._take_home,
}
