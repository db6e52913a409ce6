"""Transport: uvicorn's protocols with timeouts for slow or unresponsive clients."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from raystream.viewer.server.websocket import ABORT

#: Seconds for a client to send the head of a request.
HEAD_TIMEOUT = 10.0

#: Seconds for a client to read some of its pending data.
READ_TIMEOUT = 20.0

#: Seconds from closing a connection until it is aborted, with or without pending data.
CLOSE_TIMEOUT = 5.0

#: Maximum connections in total and from one address; a page uses up to seven.
MAX_SOCKETS = 640
MAX_SOCKETS_PER_ADDRESS = 256


class _Timer:
    """A timer that can be restarted and stopped."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._timer: asyncio.TimerHandle | None = None

    def set(self, seconds: float, action: Callable[[], object]) -> None:
        """Start the timer, replacing the previous action."""
        self.stop()
        self._timer = self._loop.call_later(seconds, action)

    def stop(self) -> None:
        """Stop the timer."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class HttpProtocol(H11Protocol):
    """HTTP with limits on slow clients, clients that do not read, and their number."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.access_log = False  # its lines would contain the token
        self._head = _Timer(self.loop)
        self._read = _Timer(self.loop)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Enforce connection limits, and wait for a request."""
        super().connection_made(transport)
        if (
            len(self.connections) > MAX_SOCKETS
            or self._connections_of_client() > MAX_SOCKETS_PER_ADDRESS
        ):
            transport.abort()
            return
        self._head.set(HEAD_TIMEOUT, self._give_up)

    def connection_lost(self, error: Exception | None) -> None:
        """Stop the timers."""
        self._head.stop()
        self._read.stop()
        super().connection_lost(error)

    def data_received(self, data: bytes) -> None:
        """Process data; once the head of a request is complete, the application sets timeouts."""
        super().data_received(data)
        cycle: Any = self.cycle  # None before the first request
        if cycle is not None and not cycle.response_complete:
            self._head.stop()

    def on_response_complete(self) -> None:
        """Wait for the next request, or for the end."""
        self._head.set(HEAD_TIMEOUT, self._give_up)
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Hand the connection to the websocket protocol."""
        self._head.stop()
        super().handle_websocket_upgrade(event)

    def pause_writing(self) -> None:
        """Start the timeout for a client that does not read."""
        super().pause_writing()
        self._read.set(READ_TIMEOUT, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the timeout: the client has read."""
        super().resume_writing()
        self._read.stop()

    def _connections_of_client(self) -> int:
        """Count connections from the same address."""
        if self.client is None:
            return 1
        clients = [getattr(connection, "client", None) for connection in self.connections]
        return sum(one is not None and one[0] == self.client[0] for one in clients)

    def _give_up(self) -> None:
        """Close, but let the client read pending data."""
        self.transport.close()
        self._read.set(READ_TIMEOUT, self.transport.abort)


class WebSocketProtocol(WebSocketsSansIOProtocol):
    """A websocket with a timeout for clients that do not read; the application can abort it."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.close_timeout = CLOSE_TIMEOUT
        self._read = _Timer(self.loop)

    def handle_connect(self, event: Any) -> None:
        """Start the connection, and give the application a way to abort it."""
        super().handle_connect(event)
        if hasattr(self, "scope"):
            self.scope["extensions"][ABORT] = {"call": self.transport.abort}

    def connection_lost(self, error: Exception | None) -> None:
        """Stop the timer."""
        self._read.stop()
        super().connection_lost(error)

    def pause_writing(self) -> None:
        """Wait for the client to read, and answer no pings meanwhile."""
        super().pause_writing()
        self.transport.pause_reading()
        self._read.set(READ_TIMEOUT, self.transport.abort)

    def resume_writing(self) -> None:
        """Resume: the client has read."""
        super().resume_writing()
        if self.transport.is_closing():
            return
        if not self.read_paused:
            self.transport.resume_reading()
        self._read.stop()

    async def send(self, message: Any) -> None:
        """Send; marks a rejected handshake as complete, so that it is not logged as an error."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get("more_body"):
            self.handshake_complete = True

    async def run_asgi(self) -> None:
        """Run the application; unread data is not waited for."""
        await super().run_asgi()
        self._abort_later()

    def keepalive_timeout(self) -> None:
        """Close the connection of a client that answers no pings."""
        super().keepalive_timeout()
        self._abort_later()

    def shutdown(self) -> None:
        """Close the connection when the server stops."""
        super().shutdown()
        self._abort_later()

    def _abort_later(self) -> None:
        if self in self.connections:
            self._read.set(CLOSE_TIMEOUT, self.transport.abort)
