"""SendQueue: a bounded queue from the rendering threads to a client."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from raystream.viewer.server.protocol import pack

if TYPE_CHECKING:
    from raystream.viewer.messages import Frame

#: Maximum backlog of a client that reads slowly; beyond it the connection is dropped. The largest
#: message is a screenshot of maximum size.
MAX_WAITING_BYTES = 64 << 20
MAX_WAITING_MESSAGES = 1024


class SendQueue:
    """A queue of outgoing messages to one client.

    Any thread adds messages without blocking; the event loop removes them.

    Parameters
    ----------
    loop : asyncio.AbstractEventLoop
        The event loop that removes them.
    greeting : mapping
        Fields added by the server to the message ``"hello"``. Its ``"limits"`` are merged
        with those of the message.

    Attributes
    ----------
    error_count : int
        Number of errors so far that blame a message of the client.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, greeting: Mapping[str, Any]) -> None:
        self.error_count = 0
        self._loop = loop
        self._greeting = greeting
        self._filled = asyncio.Event()
        self._overflow = asyncio.Event()
        self._lock = threading.Lock()
        self._waiting: deque[str | bytes] = deque()
        self._byte_count = 0
        self._is_closed = False

    def put(self, message: dict[str, Any] | Frame) -> None:
        """Add a message; dropped once the queue is closed or over its limit."""
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
                self._set(self._overflow)
        self._set(self._filled)

    async def take(self) -> str | bytes | None:
        """Wait for the next message; None once the queue is closed."""
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
        """Add the last message; messages before it are still sent."""
        self.put(message)
        with self._lock:
            self._is_closed = True
        self._set(self._filled)

    def close(self) -> None:
        """Discard waiting messages, and accept no more."""
        with self._lock:
            self._end()
        self._set(self._filled)

    async def wait_for_overflow(self) -> None:
        """Wait until the limit is exceeded.

        Raises
        ------
        TimeoutError
            When it is: the client reads too slowly.
        """
        await self._overflow.wait()
        raise TimeoutError("the client reads too slowly")

    def _set(self, event: asyncio.Event) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has stopped before the engine
            self._loop.call_soon_threadsafe(event.set)

    def _end(self) -> None:
        self._is_closed = True
        self._waiting.clear()
        self._byte_count = 0
