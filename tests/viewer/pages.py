"""A page as the service sees it: records messages, and waits for them."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image

from raystream.viewer import Client, Frame, RenderService

#: Timeout of waits in seconds; only compilation may take longer.
TIMEOUT = 300.0


class Page:
    """A client that acknowledges its frames, unless told not to."""

    def __init__(
        self, service: RenderService, *, shows: bool = True, size: tuple[int, int] = (32, 24)
    ):
        self.received: list[Any] = []
        self.shows = shows
        self._changed = threading.Condition()
        self.client: Client = service.join(self._receive)
        self.take("size", width=size[0], height=size[1])

    def _receive(self, message: Any) -> None:
        with self._changed:
            self.received.append(message)
            self._changed.notify_all()
        if isinstance(message, Frame) and message.header["type"] == "frame" and self.shows:
            self.take("shown", frame=message.header["number"])

    def take(self, kind: str, **fields: Any) -> None:
        client = getattr(self, "client", None)
        if client is not None:
            client.handle({"type": kind, **fields})

    def wait(self, wanted: Callable[[Any], bool], timeout: float = TIMEOUT) -> Any:
        """The first received item that matches."""
        seen = 0

        def find() -> Any:
            nonlocal seen
            while seen < len(self.received):
                seen += 1
                if wanted(self.received[seen - 1]):
                    return (self.received[seen - 1],)
            return None

        with self._changed:
            found = self._changed.wait_for(find, timeout)
        assert found, f"only got {[brief(one) for one in self.received]}"
        return found[0]

    def message(self, kind: str, **fields: Any) -> dict[str, Any]:
        """The first message of a kind, with these fields."""
        return self.wait(
            lambda one: (
                isinstance(one, dict)
                and one["type"] == kind
                and all(one.get(name) == value for name, value in fields.items())
            )
        )

    def frame(self, **fields: Any) -> Frame:
        """The first frame with these fields."""
        return self.wait(
            lambda one: (
                isinstance(one, Frame)
                and all(one.header.get(name) == value for name, value in fields.items())
            )
        )

    def frames(self) -> list[Frame]:
        with self._changed:
            return [one for one in self.received if isinstance(one, Frame)]

    def forget(self) -> None:
        """Forget everything received so far."""
        with self._changed:
            self.received.clear()


def brief(one: Any) -> Any:
    kept = ("type", "number", "samples", "done", "message", "refused", "structure", "mode")
    fields = one.header if isinstance(one, Frame) else one
    return {name: fields[name] for name in kept if name in fields}


def decode(frame: Frame) -> np.ndarray:
    """A frame's image: shape (H, W, 3), uint8."""
    return np.asarray(Image.open(io.BytesIO(frame.content)).convert("RGB"))
