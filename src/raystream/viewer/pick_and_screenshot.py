"""Single requests of a client beside the frames: picking and screenshots."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from raystream.tracer import Tracer
from raystream.viewer.encoding import encode_png
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Frame, Message
from raystream.viewer.picking import PixelRay, hits_along
from raystream.viewer.progressive_images import Drawing
from raystream.viewer.tracers import device_lock
from raystream.viewer.walks import walk_along


class PickQueue:
    """Runs pick queries one at a time; a newer pick replaces a waiting one.

    Parameters
    ----------
    jobs : Jobs
    send : callable
        Sends a message to the page.
    """

    def __init__(self, jobs: Jobs, send: Callable[[Message], object]) -> None:
        self._jobs, self._send = jobs, send
        self._lock = threading.Lock()
        self._job: Job | None = None
        self._next: tuple[Tracer, PixelRay] | None = None

    def submit(self, tracer: Tracer, ray: PixelRay) -> None:
        """Find the hits along a ray and send them; of several waiting picks, keep the last."""
        with self._lock:
            if self._job is not None:
                self._next = tracer, ray
                return
            self._start(tracer, ray)

    def end(self) -> None:
        """Discard pending results."""
        with self._lock:
            self._next = None
            if self._job is not None:
                self._job.cancel()

    def _start(self, tracer: Tracer, ray: PixelRay) -> None:
        def work(_: Job) -> None:
            with device_lock(tracer.device):
                found = ray.message() | hits_along(tracer, ray)
            self._send(found | walk_along(tracer, ray))
            self._start_next()

        def failed(reason: str) -> None:
            self._send({"type": "error", "message": reason, "about": "pick"})
            self._start_next()

        self._job = Job(lambda *_: None)
        self._jobs.start(self._job, work, failed)

    def _start_next(self) -> None:
        with self._lock:
            following, self._next, self._job = self._next, None, None
            if following is not None:
                self._start(*following)


def send_screenshot(
    draw: Callable[[], Drawing],
    header: Message,
    jobs: Jobs,
    send: Callable[[Message | Frame], object],
    end: Callable[[], object],
) -> None:
    """Encode an image as a PNG, and send it.

    Parameters
    ----------
    draw : callable
        Returns the pixels.
    header : dict
    jobs : Jobs
    send : callable
        Sends to the page.
    end : callable
        Called when the image is sent, or has failed.
    """

    def work(_: Job) -> None:
        started = time.perf_counter()
        pixels, display = draw()
        content = encode_png(pixels, display)
        made = {
            "encode_ms": round(1e3 * (time.perf_counter() - started), 3),
            "format": "image/png",
            "width": pixels.shape[1],
            "height": pixels.shape[0],
        }
        end()
        send(Frame(header | made, content))

    def failed(reason: str) -> None:
        end()
        send({"type": "error", "message": reason, "about": "screenshot"})

    jobs.start(Job(lambda *_: None), work, failed)
