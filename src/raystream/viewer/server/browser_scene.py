"""Scenes for browsers: sends a page its scene, to be traced there."""

from __future__ import annotations

import asyncio

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from raystream.core.errors import RaystreamError
from raystream.viewer.server.connections import Connections
from raystream.viewer.server.uploads import KEY_HEADER

__all__ = ["SceneSender"]


class SceneSender:
    """Answers requests for scenes, one at a time, and of each page the last one that waits.

    Parameters
    ----------
    connections : Connections
    """

    def __init__(self, connections: Connections) -> None:
        self._connections = connections
        self._turn = asyncio.Lock()
        self._latest: dict[str, Request] = {}

    async def send(self, request: Request) -> Response:
        """Send the scene of a connection.

        Parameters
        ----------
        request : Request
            ``GET /scene``, with the connection's key in a header.

        Returns
        -------
        Response
            The packed scene, or a one-line reason.
        """
        key = request.headers.get(KEY_HEADER, "")
        connection = self._connections.find(key)
        if connection is None or connection.client is None:
            return PlainTextResponse("the key does not belong to a live connection\n", 403)
        self._latest[key] = request
        try:
            async with self._turn:
                if self._latest.get(key) is not request:  # what the page wants now
                    return PlainTextResponse("the page has asked again since\n", 409)
                content = await asyncio.to_thread(connection.client.packed_scene)
        except (RaystreamError, MemoryError) as error:
            reason = connection.uploads.without_paths(str(error) or "out of memory")
            return PlainTextResponse(f"{reason}\n", 409)
        finally:
            if self._latest.get(key) is request:
                del self._latest[key]
        return Response(content, media_type="application/octet-stream")
