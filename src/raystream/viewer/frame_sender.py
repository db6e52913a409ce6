"""FrameSender: sends messages and frames to a page, at the rate at which it shows them."""

from __future__ import annotations

import threading
from collections.abc import Callable

from raystream.viewer.encoding import MOVING_QUALITY, STILL_QUALITY, Encoder, encode_jpeg
from raystream.viewer.frame_renderer import RenderedFrame
from raystream.viewer.messages import Frame, Message, MessageError, Send, error_text

#: Maximum frames in flight that the page has not acknowledged.
_MAX_IN_FLIGHT = 2


class FrameSender:
    """Encodes and sends frames one at a time, and sends messages.

    Parameters
    ----------
    send : callable
        See `Send`.
    encoder : Encoder
    on_room : callable
        Called when another frame can be queued.
    on_lost : callable
        Called when the page is unreachable.
    """

    def __init__(
        self,
        send: Send,
        encoder: Encoder,
        on_room: Callable[[], object],
        on_lost: Callable[[], object],
    ) -> None:
        self._send, self._encoder = send, encoder
        self._on_room, self._on_lost = on_room, on_lost
        self._lock = threading.Lock()
        self._sent = self._shown = 0
        self._is_encoding = self._is_closed = False
        self._held: RenderedFrame | None = None

    @property
    def has_room(self) -> bool:
        """Whether another frame can be queued."""
        with self._lock:
            return self._held is None and self._sent - self._shown < _MAX_IN_FLIGHT

    def put(self, rendered: RenderedFrame, may_drop: bool) -> None:
        """Send a frame, as soon as the previous one is encoded and there is room.

        Parameters
        ----------
        rendered : RenderedFrame
            Replaces a frame that is still waiting.
        may_drop : bool
            Drop the frame instead of waiting.
        """
        with self._lock:
            is_busy = self._is_encoding or self._held is not None
            if not (is_busy and may_drop):
                self._held = rendered
        self._send_next()

    def acknowledge(self, number: int) -> None:
        """Record that the page has shown a frame, and all frames before it.

        Raises
        ------
        MessageError
            If no such frame was sent.
        """
        with self._lock:
            if number > self._sent:
                raise MessageError(f"frame: {self._sent} is the last one sent, got {number}")
            self._shown = max(self._shown, number)
        self._send_next()

    def send(self, message: Message | Frame) -> None:
        """Send a message."""
        if self._is_closed:
            return
        try:
            self._send(message)
        except Exception:  # of any kind: the connection is unusable
            self.close()
            self._on_lost()

    def close(self) -> None:
        """Send nothing more."""
        with self._lock:
            self._is_closed = True
            self._held = None

    def _send_next(self) -> None:
        """Encode the waiting frame, if it may be sent."""
        with self._lock:
            rendered = self._held
            is_full = self._sent - self._shown >= _MAX_IN_FLIGHT
            if rendered is None or self._is_encoding or is_full or self._is_closed:
                return
            self._held = None
            self._is_encoding = True
            self._sent += 1
            number = self._sent
        quality = MOVING_QUALITY if rendered.header["moving"] else STILL_QUALITY
        header = {**rendered.header, "number": number, "format": "image/jpeg"}

        def failed(error: Exception) -> None:
            self.send({"type": "error", "message": error_text(error), "about": "frame"})
            self._end(number)

        def done(frame: Frame) -> None:
            self.send(frame)
            self._end(0)

        self._encoder.encode(lambda: encode_jpeg(*rendered.draw(), quality), header, done, failed)

    def _end(self, unseen: int) -> None:
        """Continue after a frame; one that could not be encoded counts as shown."""
        with self._lock:
            self._is_encoding = False
            self._shown = max(self._shown, unseen)
        self._send_next()
        self._on_room()
