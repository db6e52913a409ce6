"""Outbox: what is sent to a page, and no more pictures than it can show."""

from __future__ import annotations

import threading
from collections.abc import Callable

from raystream.viewer.encoding import MOVING_QUALITY, STILL_QUALITY, Encoder, encode_jpeg
from raystream.viewer.messages import Frame, Message, MessageError, Send, error_text
from raystream.viewer.view import Shot

__all__ = ["Outbox"]

#: Frames that may be under way to the page, until it says that it has shown one.
_MOST_UNDER_WAY = 2


class Outbox:
    """Encodes and sends pictures, one at a time, and messages.

    Parameters
    ----------
    send : callable
        See `Send`.
    encoder : Encoder
    on_room : callable
        Called when there is room for another picture.
    on_lost : callable
        Called when the page cannot be reached.
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
        self._held: Shot | None = None

    @property
    def has_room(self) -> bool:
        """Whether another picture can be put in."""
        with self._lock:
            return self._held is None and self._sent - self._shown < _MOST_UNDER_WAY

    def put(self, shot: Shot, may_drop: bool) -> None:
        """Send a picture, as soon as the one before is encoded and there is room.

        Parameters
        ----------
        shot : Shot
            Takes the place of one that still waits.
        may_drop : bool
            Forget it instead of waiting.
        """
        with self._lock:
            is_busy = self._is_encoding or self._held is not None
            if not (is_busy and may_drop):
                self._held = shot
        self._go_on()

    def acknowledge(self, number: int) -> None:
        """Take note that the page has shown a frame, and all before it.

        Raises
        ------
        MessageError
            If no such frame has been sent.
        """
        with self._lock:
            if number > self._sent:
                raise MessageError(f"frame: {self._sent} is the last one sent, got {number}")
            self._shown = max(self._shown, number)
        self._go_on()

    def tell(self, message: Message | Frame) -> None:
        """Send a message."""
        if self._is_closed:
            return
        try:
            self._send(message)
        except Exception:  # whatever it is, nothing more can be sent
            self.close()
            self._on_lost()

    def close(self) -> None:
        """Send nothing more."""
        with self._lock:
            self._is_closed = True
            self._held = None

    def _go_on(self) -> None:
        """Encode what waits, if it may be sent."""
        with self._lock:
            shot = self._held
            is_full = self._sent - self._shown >= _MOST_UNDER_WAY
            if shot is None or self._is_encoding or is_full or self._is_closed:
                return
            self._held = None
            self._is_encoding = True
            self._sent += 1
            number = self._sent
        quality = MOVING_QUALITY if shot.header["moving"] else STILL_QUALITY
        header = {**shot.header, "number": number, "format": "image/jpeg"}

        def failed(error: Exception) -> None:
            self.tell({"type": "error", "message": error_text(error), "about": "frame"})
            self._end(number)

        def done(frame: Frame) -> None:
            self.tell(frame)
            self._end(0)

        self._encoder.encode(lambda: encode_jpeg(*shot.draw(), quality), header, done, failed)

    def _end(self, unseen: int) -> None:
        """Go on after a picture; nobody will acknowledge one that could not be encoded."""
        with self._lock:
            self._is_encoding = False
            self._shown = max(self._shown, unseen)
        self._go_on()
        self._on_room()
