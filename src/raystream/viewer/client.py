"""Client: one connected page; handles its messages and keeps its state."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from raystream.core.errors import RaystreamError
from raystream.viewer.browser_scene import packed_scene
from raystream.viewer.encoding import Encoder
from raystream.viewer.frame_renderer import FrameRenderer, FrameRequest
from raystream.viewer.frame_sender import FrameSender
from raystream.viewer.jobs import Jobs
from raystream.viewer.messages import (
    Message,
    MessageError,
    Send,
    error_text,
    read_bool,
    read_integer,
)
from raystream.viewer.pick_and_screenshot import PickQueue, send_screenshot
from raystream.viewer.picking import pixel_ray
from raystream.viewer.scenes import LoadedScene, read_camera
from raystream.viewer.session import Session
from raystream.viewer.settings import Settings
from raystream.viewer.tracers import device_is_free, device_lock
from raystream.viewer.view_lights import ViewLights

#: Limits of the canvas, in pixels.
MIN_SIDE, MAX_SIDE, MAX_PIXELS = 16, 4096, 8_300_000

#: Largest message number: the largest exact integer in JavaScript.
MAX_NUMBER = 1 << 53

#: Canvas size assumed if the page has not sent one after this many seconds.
_DEFAULT_SIZE, _SIZE_SECONDS = (1024, 768), 0.3

#: A camera marked as moving counts as resting after this many seconds without an update.
_STILL_SECONDS = 1.0


class WorkerPools:
    """The background threads shared by all clients of a service.

    Parameters
    ----------
    wake : callable
        Wakes the worker.

    Attributes
    ----------
    encoder : Encoder
    long_jobs : Jobs
        Long jobs.
    short_jobs : Jobs
        Short jobs, which do not wait for builds.
    """

    def __init__(self, wake: Callable[[], object]) -> None:
        self.wake = wake
        self.encoder = Encoder()
        self.long_jobs, self.short_jobs = Jobs(), Jobs()

    def close(self) -> None:
        """Stop all threads."""
        self.long_jobs.close()
        self.short_jobs.close()
        self.encoder.close()


class Client:
    """One connected page, made by `RenderService.join`.

    Thread-safe; methods for the server return at once.
    """

    def __init__(
        self,
        pools: WorkerPools,
        send: Send,
        home: LoadedScene,
        settings: Settings,
        on_leave: Callable[[Client], object],
    ) -> None:
        self._pools, self._on_leave = pools, on_leave
        self._lock = threading.RLock()
        self._sender = FrameSender(send, pools.encoder, pools.wake, self.leave)
        self.send = self._sender.send
        self._session = Session(home, settings, pools.long_jobs, self.send, self._on_change)
        self._picks = PickQueue(pools.short_jobs, self.send)
        self._lights = ViewLights()
        self._renderer = FrameRenderer(self._sender.put, self._lights)
        self._camera, self._number = home.scene.camera, 0
        self._moving, self._moved_at = False, 0.0
        self._size: tuple[int, int] | None = None
        self._joined_at = time.monotonic()
        self._paused = self._has_left = False
        self._screenshot: int | None = None
        self._is_encoding_screenshot = False
        self._failed: FrameRequest | None = None

    def begin(self) -> None:
        """Send the initial messages, and prepare the first image."""
        self._session.show(self._session.loaded)

    @property
    def has_left(self) -> bool:
        """Whether the client has disconnected."""
        return self._has_left

    # For the server.

    def handle(self, message: Any) -> None:
        """Handle a message of the page.

        Parameters
        ----------
        message : dict
            A JSON object. Invalid messages are answered by an ``"error"``, and change
            nothing.
        """
        about = message.get("type") if isinstance(message, dict) else None
        handle = _HANDLERS.get(about) if isinstance(about, str) else None
        try:
            if handle is None:
                known = ", ".join(map(repr, _HANDLERS))
                raise MessageError(f"type: expected one of {known}, got {about!r:.40}")
            if not self._has_left:
                handle(self, message)
        except MessageError as error:
            self.send({"type": "error", "message": str(error), "about": f"{about!s:.40}"})
        self._pools.wake()

    def open(self, path: Path, name: str) -> None:
        """Load a model as this client's own scene, and show it when loaded.

        Parameters
        ----------
        path : Path
            A file; it and the files it references must exist until the client has left.
        name : str
            Name of the scene.
        """
        self._session.open(path, name)

    def packed_scene(self) -> bytes:
        """Pack the scene for the page's own GPU; may take seconds.

        Raises
        ------
        RaystreamError
            If that is not supported, or the scene is too large or not ready.
        """
        settings, prepared = self._session.current
        if self._has_left or prepared is None:
            raise RaystreamError("scene: is not ready yet")
        with self._lock:
            camera = self._camera
        return packed_scene(prepared, settings, camera, self._lights)

    def leave(self) -> None:
        """Cancel all work for this client, and free its resources."""
        with self._lock:
            if self._has_left:
                return
            self._has_left = True
        self._sender.close()
        self._session.end()
        self._picks.end()
        self._on_leave(self)

    # For the worker.

    def has_work(self) -> bool:
        """Whether the worker has anything to do for this client."""
        request = self._current_request()
        if request is None or not device_is_free(request.prepared.key.device):
            return False
        if self._screenshot is not None:
            return True
        if self._failed is not None and self._failed.sample_key == request.sample_key:
            return False
        return self._sender.has_room and self._renderer.has_work(request)

    def step(self, seconds: float) -> None:
        """Render one slice.

        Parameters
        ----------
        seconds : float
            Time limit.
        """
        request = self._current_request()
        if request is None:
            return
        try:
            with device_lock(request.prepared.key.device):
                if self._screenshot is not None and self._send_screenshot(request):
                    return
                self._renderer.step(request, seconds, self._is_wanted)
        except Exception as error:  # of any kind: other clients must continue
            self._renderer.forget()
            self._failed = request
            about = "frame" if self._screenshot is None else "screenshot"
            self._screenshot = None
            self.send({"type": "error", "message": error_text(error), "about": about})

    def release(self) -> None:
        """Free the images of a client that has left."""
        self._renderer.forget()

    def _current_request(self) -> FrameRequest | None:
        """Return the current request; None if there is nothing to render."""
        with self._lock:
            choice, now = self._session, time.monotonic()
            wants_screenshot = self._screenshot is not None
            settings, prepared = choice.current
            if self._has_left or prepared is None or (self._paused and not wants_screenshot):
                return None
            size = self._size
            if size is None:
                if now < self._joined_at + _SIZE_SECONDS:
                    return None
                size = _DEFAULT_SIZE
            moving = self._moving and now < self._moved_at + _STILL_SECONDS and not wants_screenshot
            return FrameRequest(prepared, settings, self._camera, self._number, size, moving)

    def _is_wanted(self) -> bool:
        request = self._current_request()
        return request is not None and self._renderer.is_worth_finishing(request)

    def _send_screenshot(self, request: FrameRequest) -> bool:
        """Send the current image as a file, once it is available in full size."""
        image = self._renderer.full_size_image(request)
        if image is None:
            return False
        with self._lock:
            number, self._screenshot = self._screenshot, None
            self._is_encoding_screenshot = True
        header = self._renderer.header(image, request)
        header |= {"type": "screenshot", "number": number}
        draw = image.draw_whole(request.settings.display)
        send_screenshot(draw, header, self._pools.short_jobs, self.send, self._end_screenshot)
        return True

    def _end_screenshot(self) -> None:
        with self._lock:
            self._is_encoding_screenshot = False

    def _on_change(self, loaded: LoadedScene | None) -> None:
        with self._lock:
            self._failed = None
            if loaded is not None:
                self._camera, self._number, self._moving = loaded.scene.camera, 0, False
        self._pools.wake()

    # Messages.

    def _handle_camera(self, message: Message) -> None:
        number = read_integer(message, "number", 0, MAX_NUMBER)
        moving = read_bool(message, "moving")
        camera = read_camera(message)
        with self._lock:
            self._camera, self._number, self._moving = camera, number, moving
            self._moved_at = time.monotonic()

    def _handle_size(self, message: Message) -> None:
        width = read_integer(message, "width", MIN_SIDE, MAX_SIDE)
        height = read_integer(message, "height", MIN_SIDE, MAX_SIDE)
        if width * height > MAX_PIXELS:
            got = f"{width}x{height}"
            raise MessageError(f"size: expected at most {MAX_PIXELS:,} pixels, got {got}")
        with self._lock:
            self._size = width, height

    def _handle_settings(self, message: Message) -> None:
        self._session.change(message)

    def _handle_pick(self, message: Message) -> None:
        with self._lock:
            camera, size = self._camera, self._size or _DEFAULT_SIZE
            _, prepared = self._session.current
        ray = pixel_ray(message, camera, size)
        if prepared is None:
            raise MessageError("pick: the scene is not ready yet")
        self._picks.submit(prepared.tracer, ray)

    def _handle_shown(self, message: Message) -> None:
        self._sender.acknowledge(read_integer(message, "frame", 1, MAX_NUMBER))

    def _handle_screenshot(self, message: Message) -> None:
        number = read_integer(message, "number", 0, MAX_NUMBER)
        with self._lock:
            if self._screenshot is not None or self._is_encoding_screenshot:
                raise MessageError("screenshot: the previous one is not ready yet")
            self._screenshot = number

    def _handle_pause(self, message: Message) -> None:
        paused = read_bool(message, "paused")
        with self._lock:
            self._paused = paused

    def _handle_home(self, message: Message) -> None:
        del message
        self._session.home()


_HANDLERS: dict[str, Callable[[Client, Message], None]] = {
    "camera": Client._handle_camera,
    "size": Client._handle_size,
    "settings": Client._handle_settings,
    "pick": Client._handle_pick,
    "shown": Client._handle_shown,
    "screenshot": Client._handle_screenshot,
    "pause": Client._handle_pause,
    "home": Client._handle_home,
}
