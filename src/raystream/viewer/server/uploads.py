"""Uploads: model files that a page sends for its own connection."""

from __future__ import annotations

import asyncio

from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response

from raystream.viewer.server.names import is_upload_id, safe_name
from raystream.viewer.server.upload_folder import (
    ArrivingFile,
    BusyError,
    FullError,
    RefusedError,
    TooLargeError,
)
from raystream.viewer.server.visits import Visits

__all__ = ["KEY_HEADER", "receive_upload"]

#: Says which connection an upload belongs to.
KEY_HEADER = "X-Upload-Key"

#: Seconds without a byte, and bytes a second on average after that, below which an upload ends.
IDLE_TIMEOUT = 20.0
LEAST_RATE = 4096.0


async def receive_upload(request: Request, visits: Visits) -> Response:
    """Receive one file.

    Parameters
    ----------
    request : Request
        ``PUT /uploads/ID/NAME`` with the file as its body.
    visits : Visits

    Returns
    -------
    Response
        204, or one line that says why not. What is refused is not read.
    """
    upload, name = request.path_params["upload"], request.path_params["name"]
    visit = visits.of_key(request.headers.get(KEY_HEADER, ""))
    if visit is None:
        return _refusal(403, "no live connection has this upload key")
    if not is_upload_id(upload):
        return _refusal(400, "upload: expected 16 to 32 small letters and digits")
    try:
        name = safe_name(name)
        claimed = _claimed(request)
    except ValueError as error:
        return _refusal(400, str(error))
    try:
        with visit.uploads.receive(upload, name, claimed) as arriving:
            await _store(request, arriving)
    except TooLargeError as error:
        return _refusal(413, str(error))
    except BusyError as error:
        return _refusal(503, str(error))
    except FullError as error:
        return _refusal(507, str(error))
    except RefusedError as error:
        return _refusal(409, str(error))
    except TimeoutError:
        return _refusal(408, "the file came too slowly")
    except OSError as error:
        return _refusal(507, f"the file could not be kept: {error.strerror}")
    except ClientDisconnect:
        return _refusal(400, "the file did not come as a whole")
    return Response(status_code=204)


async def _store(request: Request, arriving: ArrivingFile) -> None:
    """Write the body down while it comes, counting."""
    clock = asyncio.get_running_loop()
    started = clock.time()
    chunks = request.stream()
    while True:
        async with asyncio.timeout(IDLE_TIMEOUT):
            chunk = await anext(chunks, None)
        if chunk is None:
            break
        arriving.write(chunk)
        spent = clock.time() - started - IDLE_TIMEOUT
        if arriving.size < spent * LEAST_RATE:
            raise TimeoutError
    arriving.finish()


def _claimed(request: Request) -> int | None:
    """How many bytes the client says that it sends; None for a body in chunks."""
    text = request.headers.get("content-length")
    if text is None:
        return None
    if not text.isascii() or not text.isdigit() or len(text) > 20:
        raise ValueError("Content-Length: expected a number of bytes")
    return int(text)


def _refusal(status: int, reason: str) -> Response:
    """Say why not, and read no more of the body."""
    return PlainTextResponse(f"{reason}\n", status, headers={"Connection": "close"})
