"""Socket: one live connection, from hello to the end."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from raystream.viewer.server.messages import MalformedError, UnusableError, parse_message
from raystream.viewer.server.names import is_upload_id, model_suffixes, safe_name
from raystream.viewer.server.outbox import Outbox
from raystream.viewer.server.pace import Pace

if TYPE_CHECKING:
    from raystream.viewer.server.visits import Visit, Visits
    from raystream.viewer.studio import Studio

__all__ = ["ABORT", "live"]

#: Name of the ASGI extension by which a connection is cut, for clients that read nothing.
ABORT = "raystream.abort"

#: Bad messages in a row after which a client is taken for hostile or broken.
MAX_ERRORS_IN_A_ROW = 50

#: Seconds in which a client has to take a message.
SEND_TIMEOUT = 20.0

#: Close codes, as RFC 6455 and its registry name them.
GOING_AWAY, NO_BINARY, NOT_JSON, MISUSE, FAILED, TRY_LATER = 1001, 1003, 1007, 1008, 1011, 1013


class _EndError(Exception):
    """The connection is to be closed."""

    def __init__(self, code: int, reason: str) -> None:
        super().__init__(reason)
        self.code = code
        self.reason = reason


async def live(websocket: WebSocket, studio: Studio, visits: Visits) -> None:
    """Serve one connection; return when it has ended and all that it held is free.

    Parameters
    ----------
    websocket : WebSocket
        Not yet accepted; the guard has let it pass.
    studio : Studio
    visits : Visits
    """
    await websocket.accept()
    loop = asyncio.get_running_loop()
    visit = visits.begin(
        lambda key: Outbox(
            loop, {"upload_key": key, "limits": {"upload_bytes": visits.upload_limit}}
        )
    )
    if visit is None:
        reason = visits.refusal
        with contextlib.suppress(WebSocketDisconnect):
            await websocket.send_json({"type": "closing", "reason": reason})
            await websocket.close(TRY_LATER, reason)
        return
    try:
        await _attend(websocket, studio, visit)
    finally:
        visits.end(visit)


async def _attend(websocket: WebSocket, studio: Studio, visit: Visit) -> None:
    """Let messages go both ways until one way ends."""
    visit.visitor = studio.join(visit.tell)
    ways = {
        asyncio.create_task(_send_all(websocket, visit.outbox)),
        asyncio.create_task(_receive_all(websocket, visit)),
        asyncio.create_task(visit.outbox.run_over()),
    }
    try:
        done, _ = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        visit.visitor.leave()  # at once: nothing is rendered for nobody
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
    for way in done:
        await _end(websocket, way.exception())


async def _end(websocket: WebSocket, error: BaseException | None) -> None:
    """Close the connection for the reason for which one way ended."""
    if isinstance(error, TimeoutError):
        abort = websocket.scope.get("extensions", {}).get(ABORT)
        if abort is not None:
            abort["call"]()
        return
    if isinstance(error, _EndError) and websocket.application_state == WebSocketState.CONNECTED:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await websocket.close(error.code, error.reason)
    elif error is not None and not isinstance(error, WebSocketDisconnect):
        raise error


async def _send_all(websocket: WebSocket, outbox: Outbox) -> None:
    """Send what the engine has for the client, as fast as the client takes it."""
    while (message := await outbox.take()) is not None:
        async with asyncio.timeout(SEND_TIMEOUT):
            if isinstance(message, str):
                await websocket.send_text(message)
            else:
                await websocket.send_bytes(message)
    raise _EndError(GOING_AWAY, "the viewer has ended")


async def _receive_all(websocket: WebSocket, visit: Visit) -> None:
    """Hand what the client sends to the engine."""
    pace = Pace()
    bad_count = 0
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1000))
        text = message.get("text")
        if text is None:
            raise _EndError(NO_BINARY, "expected text")
        errors_before = visit.outbox.error_count
        try:
            _hand_over(parse_message(text), visit)
        except MalformedError as error:
            raise _EndError(NOT_JSON, str(error)) from None
        except UnusableError as error:
            visit.outbox.put({"type": "error", "message": str(error), "about": None})
        bad_count = bad_count + 1 if visit.outbox.error_count > errors_before else 0
        if bad_count > MAX_ERRORS_IN_A_ROW:
            raise _EndError(MISUSE, "too many messages that cannot be used")
        await pace.wait()


def _hand_over(message: dict[str, Any], visit: Visit) -> None:
    assert visit.visitor is not None
    if message["type"] == "open":
        _open(message, visit)
    else:
        visit.visitor.take(message)


def _open(message: dict[str, Any], visit: Visit) -> None:
    """Show a model that this connection has sent, and nothing else."""
    assert visit.visitor is not None
    upload = message.get("upload")
    try:
        name = safe_name(message.get("name"))
        if not isinstance(upload, str) or not is_upload_id(upload):
            raise ValueError("upload: expected 16 to 32 small letters and digits")
        if not name.lower().endswith(model_suffixes()):
            raise ValueError(f"{name}: is not a model")
        path = visit.uploads.find(upload, name)
        if path is None:
            raise ValueError(f"{name}: has not been uploaded")
    except ValueError as error:
        visit.outbox.put({"type": "error", "message": str(error), "about": "open"})
        return
    visit.visitor.open(path, name)
