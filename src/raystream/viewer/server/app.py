"""App: the routes of the viewer, and nothing beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from raystream.viewer.server.access import Access
from raystream.viewer.server.guard import Guard
from raystream.viewer.server.pages import INDEX, read_page_files
from raystream.viewer.server.socket import live
from raystream.viewer.server.uploads import receive_upload
from raystream.viewer.server.visits import Visits

if TYPE_CHECKING:
    from raystream.viewer.studio import Studio

__all__ = ["make_app"]


def make_app(studio: Studio, visits: Visits, access: Access) -> ASGIApp:
    """Make the application.

    Parameters
    ----------
    studio : Studio
        What renders.
    visits : Visits
        Who is connected.
    access : Access
        Who may be.

    Returns
    -------
    ASGI application
        ``GET /``, ``GET /page/NAME``, ``PUT /uploads/ID/NAME`` and the websocket ``/live``;
        whatever else is asked for is not there.
    """
    files = read_page_files()

    async def page(request: Request) -> Response:
        file = files.get(request.path_params.get("name", INDEX))
        if file is None:
            return PlainTextResponse("there is no such page\n", 404)
        return Response(file.content, media_type=file.media_type)

    async def upload(request: Request) -> Response:
        return await receive_upload(request, visits)

    async def socket(websocket: WebSocket) -> None:
        await live(websocket, studio, visits)

    routes = [
        Route("/", page, methods=["GET"]),
        Route("/page/{name}", page, methods=["GET"]),
        Route("/uploads/{upload}/{name}", upload, methods=["PUT"]),
        WebSocketRoute("/live", socket),
    ]
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return Guard(app, access)
