"""Outbox: from the threads that render to a client, bounded."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from raystream.viewer.server.messages import pack

if TYPE_CHECKING:
    from raystream.viewer.messages import Frame

__all__ = ["Outbox"]

#: What may wait for a client that reads slowly; whoever lets more pile up is dropped. A
#: screenshot of the largest size is the longest message.
MAX_WAITING_BYTES = 64 << 20
MAX_WAITING_MESSAGES = 1024


class Outbox:
    """Messages on their way to one client.

    Any thread puts messages in, and never waits; the event loop takes them out.

    Parameters
    ----------
    loop : asyncio.AbstractEventLoop
        The one that takes them out.
    greeting : mapping
        What to add to the message ``"hello"``: the engine does not know it. Its value for
        ``"limits"`` is added to the message's own.

    Attributes
    ----------
    error_count : int
        Answers so far that blame a message of the client.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, greeting: Mapping[str, Any]) -> None:
        self.error_count = 0
        self._loop = loop
        self._greeting = greeting
        self._filled = asyncio.Event()
        self._too_full = asyncio.Event()
        self._lock = threading.Lock()
        self._waiting: deque[str | bytes] = deque()
        self._byte_count = 0
        self._is_closed = False

    def put(self, message: dict[str, Any] | Frame) -> None:
        """Add a message; after the end, and once too much waits, it goes nowhere."""
        if isinstance(message, dict):
            if message.get("type") == "hello":
                limits = {**message.get("limits", {}), **self._greeting["limits"]}
                message = {**message, **self._greeting, "limits": limits}
            elif message.get("type") == "error":
                self.error_count += 1
        packed = pack(message)
        with self._lock:
            if self._is_closed:
                return
            self._waiting.append(packed)
            self._byte_count += len(packed)
            if self._byte_count > MAX_WAITING_BYTES or len(self._waiting) > MAX_WAITING_MESSAGES:
                self._end()
                self._set(self._too_full)
        self._set(self._filled)

    async def take(self) -> str | bytes | None:
        """Wait for the next message; None once the outbox is closed."""
        while True:
            with self._lock:
                if self._waiting:
                    message = self._waiting.popleft()
                    self._byte_count -= len(message)
                    return message
                if self._is_closed:
                    return None
                self._filled.clear()
            await self._filled.wait()

    def finish(self, message: dict[str, Any]) -> None:
        """Add the last message; what waits before it still goes out."""
        self.put(message)
        with self._lock:
            self._is_closed = True
        self._set(self._filled)

    def close(self) -> None:
        """Drop what waits, and take nothing more."""
        with self._lock:
            self._end()
        self._set(self._filled)

    async def run_over(self) -> None:
        """Wait until too much waits.

        Raises
        ------
        TimeoutError
            Then: the client reads too slowly.
        """
        await self._too_full.wait()
        raise TimeoutError("the client reads too slowly")

    def _set(self, event: asyncio.Event) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended before the engine
            self._loop.call_soon_threadsafe(event.set)

    def _end(self) -> None:
        self._is_closed = True
        self._waiting.clear()
        self._byte_count = 0
