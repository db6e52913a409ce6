"""Guard: checks every request before the application sees it."""

from __future__ import annotations

from typing import NamedTuple
from urllib.parse import parse_qsl

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from raystream.viewer.server.access import Access

#: Content policy: no inline scripts or styles, and nothing from other hosts.
_CONTENT = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
    "connect-src 'self'; font-src 'self'; manifest-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors "
)

#: Notebooks on this machine, in a browser or in an editor, that may frame the page.
_NOTEBOOKS = (
    "'self' http://localhost:* http://127.0.0.1:* https://localhost:* https://127.0.0.1:* "
    "vscode-webview: vscode-file:"
)

#: Sent after a valid token. A redirect would not work: a browser that followed a link from another
#: site sends no strict cookie along a redirect, but does for a request from this page.
_WELCOME = '<!doctype html><title>raystream</title><p><a href="/">Continue to the viewer</a>'

#: Queries with more parts than this are not searched for a token.
_MAX_QUERY_PARTS = 8


class _Rejection(NamedTuple):
    status: int
    reason: str


class Guard:
    """Passes requests of the viewer's own page, and rejects all others.

    Every response, including rejections, carries headers that send the browser what the page
    may load and which sites may frame it.

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
        if access.is_loopback:  # browsers honour it on trustworthy origins only
            self._headers["Cross-Origin-Opener-Policy"] = "same-origin"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Reject the request, or pass it to the application."""
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
        """Return the response to a rejected request; None if it passes."""
        headers = Headers(scope=scope)
        rejection = self._check_host(headers) or self._check_origin(scope, headers)
        if rejection is None and self._access.token is not None:
            if scope["type"] == "http" and scope["method"] == "GET" and self._has_token(scope):
                return self._welcome()
            if not self._has_cookie(headers):
                rejection = _Rejection(
                    401, "open this viewer by the address with ?token= that it printed"
                )
        if rejection is None:
            return None
        return PlainTextResponse(
            f"raystream: {rejection.reason}\n", rejection.status, headers={"Connection": "close"}
        )

    def _check_host(self, headers: Headers) -> _Rejection | None:
        hosts = headers.getlist("host")
        if len(hosts) == 1 and self._access.accepts_host(hosts[0]):
            return None
        return _Rejection(403, "the Host header does not name this viewer")

    def _check_origin(self, scope: Scope, headers: Headers) -> _Rejection | None:
        """Check the origin: only the page itself may open a websocket or send data."""
        origins = headers.getlist("origin")
        must_have = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if not origins and not must_have:
            return None
        host = headers["host"].lower()
        own = (f"http://{host}", f"https://{host}")  # the latter behind a tunnel
        if len(origins) == 1 and origins[0].lower() in own:
            return None
        return _Rejection(403, "the Origin is not this viewer's page")

    def _has_cookie(self, headers: Headers) -> bool:
        prefix = f"{self._access.cookie_name}="
        cookies = [part.strip() for line in headers.getlist("cookie") for part in line.split(";")]
        return any(
            self._access.accepts_cookie(cookie.removeprefix(prefix))
            for cookie in cookies
            if cookie.startswith(prefix)
        )

    def _has_token(self, scope: Scope) -> bool:
        query = scope["query_string"].decode("latin-1")
        try:
            parts = parse_qsl(query, max_num_fields=_MAX_QUERY_PARTS)
        except ValueError:
            return False
        return any(name == "token" and self._access.accepts_token(value) for name, value in parts)

    def _welcome(self) -> Response:
        """Exchange the token for a cookie that scripts cannot read, and load the page."""
        welcome = HTMLResponse(_WELCOME, headers={"Refresh": "0; url=/"})
        welcome.set_cookie(
            self._access.cookie_name, self._access.cookie_value, httponly=True, samesite="strict"
        )
        return welcome
