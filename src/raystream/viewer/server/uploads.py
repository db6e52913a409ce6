"""Uploads: receives model files from a page."""

from __future__ import annotations

import asyncio

from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response

from raystream.viewer.server.connections import Connections
from raystream.viewer.server.file_names import is_upload_id, safe_name
from raystream.viewer.server.upload_folder import (
    BusyError,
    FullError,
    IncomingFile,
    RejectedError,
    TooLargeError,
)

#: Header that names the connection to which an upload belongs.
KEY_HEADER = "X-Upload-Key"

#: Timeout without data in seconds, and minimum average rate in bytes per second after that.
IDLE_TIMEOUT = 20.0
MIN_RATE = 4096.0


async def receive_upload(request: Request, connections: Connections) -> Response:
    """Receive one file.

    Parameters
    ----------
    request : Request
        ``PUT /uploads/ID/NAME`` with the file as its body.
    connections : Connections

    Returns
    -------
    Response
        204, or a one-line reason. The body of a rejected request is not read.
    """
    upload, name = request.path_params["upload"], request.path_params["name"]
    connection = connections.find(request.headers.get(KEY_HEADER, ""))
    if connection is None:
        return _rejection(403, "the upload key does not belong to a live connection")
    if not is_upload_id(upload):
        return _rejection(400, "upload: expected 16 to 32 lower-case letters and digits")
    try:
        name = safe_name(name)
        claimed = _claimed(request)
    except ValueError as error:
        return _rejection(400, str(error))
    try:
        with connection.uploads.receive(upload, name, claimed) as incoming:
            await _store(request, incoming)
    except TooLargeError as error:
        return _rejection(413, str(error))
    except BusyError as error:
        return _rejection(503, str(error))
    except FullError as error:
        return _rejection(507, str(error))
    except RejectedError as error:
        return _rejection(409, str(error))
    except TimeoutError:
        return _rejection(408, "the upload was too slow")
    except OSError as error:
        return _rejection(507, f"the file could not be saved: {error.strerror}")
    except ClientDisconnect:
        return _rejection(400, "the upload is incomplete")
    return Response(status_code=204)


async def _store(request: Request, incoming: IncomingFile) -> None:
    """Write the body to disk as it arrives, checking limits."""
    clock = asyncio.get_running_loop()
    started = clock.time()
    chunks = request.stream()
    while True:
        async with asyncio.timeout(IDLE_TIMEOUT):
            chunk = await anext(chunks, None)
        if chunk is None:
            break
        incoming.write(chunk)
        spent = clock.time() - started - IDLE_TIMEOUT
        if incoming.size < spent * MIN_RATE:
            raise TimeoutError
    incoming.finish()


def _claimed(request: Request) -> int | None:
    """Read the announced size; None for a chunked body."""
    text = request.headers.get("content-length")
    if text is None:
        return None
    if not text.isascii() or not text.isdigit() or len(text) > 20:
        raise ValueError("Content-Length: expected a number of bytes")
    return int(text)


def _rejection(status: int, reason: str) -> Response:
    """Make an error response, and close the connection without reading the body."""
    return PlainTextResponse(f"{reason}\n", status, headers={"Connection": "close"})
