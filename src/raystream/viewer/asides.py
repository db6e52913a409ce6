"""Asides: what a visitor asks for once, and gets beside the pictures."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from raystream.tracer import Tracer
from raystream.viewer.encoding import encode_png
from raystream.viewer.jobs import Job, Jobs
from raystream.viewer.messages import Frame, Message
from raystream.viewer.picking import PixelRay, hits_along
from raystream.viewer.pictures import Drawing
from raystream.viewer.tracers import device_lock
from raystream.viewer.walks import walk_along

__all__ = ["Picks", "send_screenshot"]


class Picks:
    """Answers what lies along rays, one at a time and the latest first.

    Parameters
    ----------
    jobs : Jobs
    tell : callable
        Sends a message to the page.
    """

    def __init__(self, jobs: Jobs, tell: Callable[[Message], object]) -> None:
        self._jobs, self._tell = jobs, tell
        self._lock = threading.Lock()
        self._job: Job | None = None
        self._next: tuple[Tracer, PixelRay] | None = None

    def ask(self, tracer: Tracer, ray: PixelRay) -> None:
        """Find what lies along a ray, and tell it; of several that wait, only the last."""
        with self._lock:
            if self._job is not None:
                self._next = tracer, ray
                return
            self._start(tracer, ray)

    def end(self) -> None:
        """Tell nothing more."""
        with self._lock:
            self._next = None
            if self._job is not None:
                self._job.break_off()

    def _start(self, tracer: Tracer, ray: PixelRay) -> None:
        def work(_: Job) -> None:
            with device_lock(tracer.device):
                found = ray.message() | hits_along(tracer, ray)
            self._tell(found | walk_along(tracer, ray))
            self._go_on()

        def failed(reason: str) -> None:
            self._tell({"type": "error", "message": reason, "about": "pick"})
            self._go_on()

        self._job = Job(lambda *_: None)
        self._jobs.start(self._job, work, failed)

    def _go_on(self) -> None:
        with self._lock:
            following, self._next, self._job = self._next, None, None
            if following is not None:
                self._start(*following)


def send_screenshot(
    draw: Callable[[], Drawing],
    header: Message,
    jobs: Jobs,
    tell: Callable[[Message | Frame], object],
    end: Callable[[], object],
) -> None:
    """Encode a picture as a PNG, and send it.

    Parameters
    ----------
    draw : callable
        Returns the pixels.
    header : dict
    jobs : Jobs
    tell : callable
        Sends to the page.
    end : callable
        Called when it is sent, or cannot be.
    """

    def work(_: Job) -> None:
        started = time.perf_counter()
        pixels, look = draw()
        content = encode_png(pixels, look)
        made = {
            "encode_ms": round(1e3 * (time.perf_counter() - started), 3),
            "format": "image/png",
            "width": pixels.shape[1],
            "height": pixels.shape[0],
        }
        end()
        tell(Frame(header | made, content))

    def failed(reason: str) -> None:
        end()
        tell({"type": "error", "message": reason, "about": "screenshot"})

    jobs.start(Job(lambda *_: None), work, failed)
