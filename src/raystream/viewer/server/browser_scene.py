"""Scenes for browsers: sends a page its scene, to be traced there."""

from __future__ import annotations

import asyncio
from weakref import WeakValueDictionary

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import Receive, Scope, Send

from raystream.core.errors import RaystreamError
from raystream.viewer.messages import error_text
from raystream.viewer.server.connections import Connection, Connections
from raystream.viewer.server.uploads import KEY_HEADER

#: Bytes that are handed to the socket at a time: what follows waits until the page has read.
_CHUNK = 1 << 20


class SceneSender:
    """Answers ``GET /scene``, with the connection's key in a header: an ASGI application.

    Scenes are packed one at a time. Each page has one answer, from its packing until the page has
    read it; of its requests that wait meanwhile the last one is answered.

    Parameters
    ----------
    connections : Connections
    """

    def __init__(self, connections: Connections) -> None:
        self._connections = connections
        self._turn = asyncio.Lock()
        self._answers: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._latest: dict[str, Request] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the packed scene of a connection, or a one-line reason."""
        request = Request(scope, receive)
        connection = self._connections.find(request.headers.get(KEY_HEADER, ""))
        if connection is None or connection.client is None:
            await _reason("the key does not belong to a live connection", 403)(scope, receive, send)
            return
        key = connection.key
        self._latest[key] = request
        is_free = self._answers.setdefault(key, asyncio.Lock())
        try:
            async with is_free:
                answer = await self._answer(request, connection)
                await answer(scope, receive, send)
        finally:
            if self._latest.get(key) is request:
                del self._latest[key]

    async def _answer(self, request: Request, connection: Connection) -> Response:
        client = connection.client
        assert client is not None
        async with self._turn:
            if self._latest.get(connection.key) is not request:  # what the page wants now
                return _reason("the page has asked again since", 409)
            if await request.is_disconnected():
                return _reason("the page has gone", 409)
            try:
                return _Chunks(await asyncio.to_thread(client.packed_scene))
            except RaystreamError as error:
                return _reason(connection.uploads.without_paths(str(error)), 409)
            except Exception as error:  # of any kind: the page shows the reason
                text = connection.uploads.without_paths(error_text(error))
                return _reason(f"The scene could not be packed: {text}", 500)


class _Chunks(Response):
    """Bytes that are sent no faster than the page reads them."""

    media_type = "application/octet-stream"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        del scope, receive
        start = {"type": "http.response.start", "status": 200, "headers": self.raw_headers}
        await send(start)
        body = memoryview(self.body)
        for first in range(0, len(body), _CHUNK):
            part = bytes(body[first : first + _CHUNK])
            await send({"type": "http.response.body", "body": part, "more_body": True})
        await send({"type": "http.response.body", "body": b""})


def _reason(text: str, status: int) -> Response:
    return PlainTextResponse(f"{text}\n", status)
