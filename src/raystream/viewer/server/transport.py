"""Transport: uvicorn's protocols, with an end to the patience that they have with clients."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from raystream.viewer.server.socket import ABORT

__all__ = ["HttpProtocol", "WebSocketProtocol"]

#: Seconds that a client has for the head of a request.
HEAD_TIMEOUT = 10.0

#: Seconds in which a client has to read something of what waits for it.
READ_TIMEOUT = 20.0

#: Seconds from the end of a connection until it is cut, whatever still waits.
CLOSE_TIMEOUT = 5.0

#: Connections of any kind, and those from one address; a page uses up to seven.
MAX_SOCKETS = 640
MAX_SOCKETS_OF_ONE = 256


class _Alarm:
    """Something that is done after a time, unless it is put off."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._timer: asyncio.TimerHandle | None = None

    def set(self, seconds: float, action: Callable[[], object]) -> None:
        """Do it after so long, and nothing that was to be done before."""
        self.stop()
        self._timer = self._loop.call_later(seconds, action)

    def stop(self) -> None:
        """Do nothing."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class HttpProtocol(H11Protocol):
    """HTTP for clients that may send slowly, read nothing, or be too many."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.access_log = False  # a line would show the token
        self._head = _Alarm(self.loop)
        self._read = _Alarm(self.loop)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count one more, and wait for its request."""
        super().connection_made(transport)
        if len(self.connections) > MAX_SOCKETS or self._of_one() > MAX_SOCKETS_OF_ONE:
            transport.abort()
            return
        self._head.set(HEAD_TIMEOUT, self._give_up)

    def connection_lost(self, error: Exception | None) -> None:
        """Let it go."""
        self._head.stop()
        self._read.stop()
        super().connection_lost(error)

    def data_received(self, data: bytes) -> None:
        """Read on; from the head of a request on, the application is patient or not."""
        super().data_received(data)
        cycle: Any = self.cycle  # None before the first request
        if cycle is not None and not cycle.response_complete:
            self._head.stop()

    def on_response_complete(self) -> None:
        """Wait for the next request, or for the end."""
        self._head.set(HEAD_TIMEOUT, self._give_up)
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Leave the connection to the other protocol."""
        self._head.stop()
        super().handle_websocket_upgrade(event)

    def pause_writing(self) -> None:
        """Wait for a client to read."""
        super().pause_writing()
        self._read.set(READ_TIMEOUT, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on: it has read."""
        super().resume_writing()
        self._read.stop()

    def _of_one(self) -> int:
        """Connections from the same address."""
        if self.client is None:
            return 1
        clients = [getattr(connection, "client", None) for connection in self.connections]
        return sum(one is not None and one[0] == self.client[0] for one in clients)

    def _give_up(self) -> None:
        """End, but let the client read what is on its way."""
        self.transport.close()
        self._read.set(READ_TIMEOUT, self.transport.abort)


class WebSocketProtocol(WebSocketsSansIOProtocol):
    """A websocket for clients that may read nothing; the application can cut it."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.close_timeout = CLOSE_TIMEOUT
        self._read = _Alarm(self.loop)

    def handle_connect(self, event: Any) -> None:
        """Begin, and tell the application how to end."""
        super().handle_connect(event)
        if hasattr(self, "scope"):
            self.scope["extensions"][ABORT] = {"call": self.transport.abort}

    def connection_lost(self, error: Exception | None) -> None:
        """Let it go."""
        self._read.stop()
        super().connection_lost(error)

    def pause_writing(self) -> None:
        """Wait for a client to read, and answer no pings meanwhile."""
        super().pause_writing()
        self.transport.pause_reading()
        self._read.set(READ_TIMEOUT, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on: it has read."""
        super().resume_writing()
        if self.transport.is_closing():
            return
        if not self.read_paused:
            self.transport.resume_reading()
        self._read.stop()

    async def send(self, message: Any) -> None:
        """Send; a refusal is an answer, too, and nothing to complain of in the log."""
        await super().send(message)
        if message["type"] == "websocket.http.response.body" and not message.get("more_body"):
            self.handshake_complete = True

    async def run_asgi(self) -> None:
        """Run the application; what it leaves unread is not waited for."""
        await super().run_asgi()
        self._end_soon()

    def keepalive_timeout(self) -> None:
        """End with a client that answers no pings."""
        super().keepalive_timeout()
        self._end_soon()

    def shutdown(self) -> None:
        """End with the server."""
        super().shutdown()
        self._end_soon()

    def _end_soon(self) -> None:
        if self in self.connections:
            self._read.set(CLOSE_TIMEOUT, self.transport.abort)
