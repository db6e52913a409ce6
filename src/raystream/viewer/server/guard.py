"""Guard: asked before everything else, whether a request may be answered at all."""

from __future__ import annotations

from typing import NamedTuple
from urllib.parse import parse_qsl

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from raystream.viewer.server.access import Access

__all__ = ["Guard"]

#: The page has no inline scripts and styles, and nothing from other hosts.
_CONTENT = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; font-src 'self'; manifest-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors "
)

#: Notebooks on this machine, in a browser or in an editor.
_NOTEBOOKS = (
    "'self' http://localhost:* http://127.0.0.1:* https://localhost:* https://127.0.0.1:* "
    "vscode-webview: vscode-file:"
)

#: After the token was right. A redirect would not do: a browser that comes by a link from
#: another site sends no strict cookie along a redirect, but does when this page asks for the next.
_WELCOME = '<!doctype html><title>raystream</title><p><a href="/">Go on to the viewer</a>'

#: A query of more parts than this has no token that anybody meant.
_MAX_QUERY_PARTS = 8


class _Refusal(NamedTuple):
    status: int
    reason: str


class Guard:
    """Lets through what comes from the viewer's own page, and from nowhere else.

    Every response, a refusal too, says to the browser what the page may load and who may frame
    it.

    Parameters
    ----------
    app : ASGI application
    access : Access
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app = app
        self._access = access
        self._headers = {
            "Content-Security-Policy": _CONTENT + (_NOTEBOOKS if access.is_loopback else "'none'"),
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Cache-Control": "no-store",
        }
        if access.is_loopback:  # browsers know it on trustworthy origins only
            self._headers["Cross-Origin-Opener-Policy"] = "same-origin"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or let the application answer."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                headers = MutableHeaders(scope=message)
                for name, value in self._headers.items():
                    headers[name] = value
            await send(message)

        answer = self._answer(scope)
        if answer is None:
            await self._app(scope, receive, send_with_headers)
        elif scope["type"] == "http" or "websocket.http.response" in scope.get("extensions", {}):
            await answer(scope, receive, send_with_headers)
        else:
            await send({"type": "websocket.close", "code": 1008, "reason": ""})

    def _answer(self, scope: Scope) -> Response | None:
        """The answer to a request that does not get through; None for one that does."""
        headers = Headers(scope=scope)
        refusal = self._fault_of_host(headers) or self._fault_of_origin(scope, headers)
        if refusal is None and self._access.token is not None:
            if scope["type"] == "http" and scope["method"] == "GET" and self._has_token(scope):
                return self._welcome()
            if not self._has_session(headers):
                refusal = _Refusal(
                    401, "this viewer is opened by the address with ?token= that it printed"
                )
        if refusal is None:
            return None
        return PlainTextResponse(
            f"raystream: {refusal.reason}\n", refusal.status, headers={"Connection": "close"}
        )

    def _fault_of_host(self, headers: Headers) -> _Refusal | None:
        hosts = headers.getlist("host")
        if len(hosts) == 1 and self._access.knows_host(hosts[0]):
            return None
        return _Refusal(403, "the name in Host is not one of this viewer")

    def _fault_of_origin(self, scope: Scope, headers: Headers) -> _Refusal | None:
        """Only the page itself may open a websocket, or send anything."""
        origins = headers.getlist("origin")
        must_have = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if not origins and not must_have:
            return None
        host = headers["host"].lower()
        own = (f"http://{host}", f"https://{host}")  # the latter behind a tunnel
        if len(origins) == 1 and origins[0].lower() in own:
            return None
        return _Refusal(403, "the Origin is not this viewer's own page")

    def _has_session(self, headers: Headers) -> bool:
        prefix = f"{self._access.cookie_name}="
        cookies = [part.strip() for line in headers.getlist("cookie") for part in line.split(";")]
        return any(
            self._access.knows_session(cookie.removeprefix(prefix))
            for cookie in cookies
            if cookie.startswith(prefix)
        )

    def _has_token(self, scope: Scope) -> bool:
        query = scope["query_string"].decode("latin-1")
        try:
            parts = parse_qsl(query, max_num_fields=_MAX_QUERY_PARTS)
        except ValueError:
            return False
        return any(name == "token" and self._access.knows_token(value) for name, value in parts)

    def _welcome(self) -> Response:
        """Exchange the token for a cookie that scripts cannot read, and go on to the page."""
        welcome = HTMLResponse(_WELCOME, headers={"Refresh": "0; url=/"})
        welcome.set_cookie(
            self._access.cookie_name, self._access.session, httponly=True, samesite="strict"
        )
        return welcome
