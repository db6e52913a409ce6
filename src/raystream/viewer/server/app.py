"""App: the routes of the viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from raystream.viewer.server.access import Access
from raystream.viewer.server.browser_scene import SceneSender
from raystream.viewer.server.connections import Connections
from raystream.viewer.server.guard import Guard
from raystream.viewer.server.page_files import INDEX, read_page_files
from raystream.viewer.server.uploads import receive_upload
from raystream.viewer.server.websocket import serve_connection

if TYPE_CHECKING:
    from raystream.viewer.render_service import RenderService


def make_app(service: RenderService, connections: Connections, access: Access) -> ASGIApp:
    """Create the application.

    Parameters
    ----------
    service : RenderService
        The render service.
    connections : Connections
        The live connections.
    access : Access
        The access rules.

    Returns
    -------
    ASGI application
        ``GET /``, ``GET /page/NAME``, ``GET /scene``, ``PUT /uploads/ID/NAME`` and the
        websocket ``/live``; everything else is 404.
    """
    files = read_page_files()

    async def page(request: Request) -> Response:
        file = files.get(request.path_params.get("name", INDEX))
        if file is None:
            return PlainTextResponse("page not found\n", 404)
        return Response(file.content, media_type=file.media_type)

    async def upload(request: Request) -> Response:
        return await receive_upload(request, connections)

    async def socket(websocket: WebSocket) -> None:
        await serve_connection(websocket, service, connections)

    routes = [
        Route("/", page, methods=["GET"]),
        Route("/page/{name}", page, methods=["GET"]),
        Route("/scene", SceneSender(connections), methods=["GET"]),
        Route("/uploads/{upload}/{name}", upload, methods=["PUT"]),
        WebSocketRoute("/live", socket),
    ]
    app = Starlette(routes=routes)
    app.router.redirect_slashes = False
    return Guard(app, access)
