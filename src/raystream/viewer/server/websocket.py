"""Websocket: one live connection, from hello to close."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from raystream.viewer.server.file_names import is_upload_id, model_suffixes, safe_name
from raystream.viewer.server.protocol import InvalidMessageError, NotJsonError, parse_message
from raystream.viewer.server.rate_limiter import RateLimiter
from raystream.viewer.server.send_queue import SendQueue

if TYPE_CHECKING:
    from raystream.viewer.render_service import RenderService
    from raystream.viewer.server.connections import Connection, Connections

#: Name of the ASGI extension that aborts a connection, for clients that do not read.
ABORT = "raystream.abort"

#: Consecutive invalid messages after which a connection is closed.
MAX_ERRORS_IN_A_ROW = 50

#: Seconds in which a client must accept a message.
SEND_TIMEOUT = 20.0

#: Close codes of RFC 6455 and its registry.
GOING_AWAY, NO_BINARY, NOT_JSON, MISUSE, FAILED, TRY_LATER = 1001, 1003, 1007, 1008, 1011, 1013


class _CloseError(Exception):
    """Closes the connection."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


async def serve_connection(
    websocket: WebSocket, service: RenderService, connections: Connections
) -> None:
    """Serve one connection; returns when it has ended and its resources are free.

    Parameters
    ----------
    websocket : WebSocket
        Not yet accepted; has passed the guard.
    service : RenderService
    connections : Connections
    """
    await websocket.accept()
    loop = asyncio.get_running_loop()
    connection = connections.begin(
        lambda key: SendQueue(
            loop, {"upload_key": key, "limits": {"upload_bytes": connections.upload_limit}}
        )
    )
    if connection is None:
        reason = connections.rejection
        with contextlib.suppress(WebSocketDisconnect):
            await websocket.send_json({"type": "closing", "reason": reason})
            await websocket.close(TRY_LATER, reason)
        return
    try:
        await _relay(websocket, service, connection)
    finally:
        connections.end(connection)


async def _relay(websocket: WebSocket, service: RenderService, connection: Connection) -> None:
    """Transfer messages both ways until one direction ends."""
    connection.client = service.join(connection.send)
    ways = {
        asyncio.create_task(_send_all(websocket, connection.send_queue)),
        asyncio.create_task(_receive_all(websocket, connection)),
        asyncio.create_task(connection.send_queue.wait_for_overflow()),
    }
    try:
        done, _ = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        connection.client.leave()  # at once, to stop rendering
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
    for way in done:
        await _end(websocket, way.exception())


async def _end(websocket: WebSocket, error: BaseException | None) -> None:
    """Close the connection for the reason that ended one direction."""
    if isinstance(error, TimeoutError):
        abort = websocket.scope.get("extensions", {}).get(ABORT)
        if abort is not None:
            abort["call"]()
        return
    if isinstance(error, _CloseError) and websocket.application_state == WebSocketState.CONNECTED:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await websocket.close(error.code, error.reason)
    elif error is not None and not isinstance(error, WebSocketDisconnect):
        raise error


async def _send_all(websocket: WebSocket, send_queue: SendQueue) -> None:
    """Send queued messages as fast as the client accepts them."""
    while (message := await send_queue.take()) is not None:
        async with asyncio.timeout(SEND_TIMEOUT):
            if isinstance(message, str):
                await websocket.send_text(message)
            else:
                await websocket.send_bytes(message)
    raise _CloseError(GOING_AWAY, "the viewer was stopped")


async def _receive_all(websocket: WebSocket, connection: Connection) -> None:
    """Pass the client's messages to the engine."""
    pace = RateLimiter()
    bad_count = 0
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1000))
        text = message.get("text")
        if text is None:
            raise _CloseError(NO_BINARY, "expected text")
        errors_before = connection.send_queue.error_count
        try:
            _dispatch(parse_message(text), connection)
        except NotJsonError as error:
            raise _CloseError(NOT_JSON, str(error)) from None
        except InvalidMessageError as error:
            connection.send_queue.put({"type": "error", "message": str(error), "about": None})
        bad_count = bad_count + 1 if connection.send_queue.error_count > errors_before else 0
        if bad_count > MAX_ERRORS_IN_A_ROW:
            raise _CloseError(MISUSE, "too many invalid messages")
        await pace.wait()


def _dispatch(message: dict[str, Any], connection: Connection) -> None:
    assert connection.client is not None
    if message["type"] == "open":
        _open(message, connection)
    else:
        connection.client.handle(message)


def _open(message: dict[str, Any], connection: Connection) -> None:
    """Show a model uploaded by this connection."""
    assert connection.client is not None
    upload = message.get("upload")
    try:
        name = safe_name(message.get("name"))
        if not isinstance(upload, str) or not is_upload_id(upload):
            raise ValueError("upload: expected 16 to 32 lower-case letters and digits")
        if not name.lower().endswith(model_suffixes()):
            raise ValueError(f"{name}: is not a model file")
        path = connection.uploads.find(upload, name)
        if path is None:
            raise ValueError(f"{name}: has not been uploaded")
    except ValueError as error:
        connection.send_queue.put({"type": "error", "message": str(error), "about": "open"})
        return
    connection.client.open(path, name)
