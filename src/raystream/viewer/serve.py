"""Serve: run a render service on an address of this machine, in a thread."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import importlib.util
import ipaddress
import os
import socket
import threading
import time
from typing import TYPE_CHECKING

from raystream.core.errors import RaystreamError
from raystream.viewer.server.access import Access

if TYPE_CHECKING:
    from uvicorn import Server as UvicornServer

    from raystream.viewer.render_service import RenderService
    from raystream.viewer.server.connections import Connections

#: Default port, if it is free.
PREFERRED_PORT = 8008

#: Maximum bytes of one upload, including all its files.
DEFAULT_UPLOAD_LIMIT = 256 << 20

#: Seconds for connections to close on shutdown, and seconds of these for pages to receive the
#: reason.
SHUTDOWN_TIMEOUT = 5
NOTIFY_TIMEOUT = 1.0


def bind(host: str = "127.0.0.1", port: int | None = None) -> socket.socket:
    """Bind a socket to an address of this machine.

    Parameters
    ----------
    host : str
        An address, or a name that resolves to one.
    port : int, optional
        Default: 8008, or any free port.

    Returns
    -------
    socket
        Bound and listening.

    Raises
    ------
    RaystreamError
        If the address is not one of this machine, or the port is in use.
    """
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError):
        raise RaystreamError(f"--host: {host!r} is not an address of this machine") from None
    family, _, _, _, address = found[0]
    if port is not None:
        return _bind_to(family, str(address[0]), port)
    try:
        return _bind_to(family, str(address[0]), PREFERRED_PORT)
    except RaystreamError:
        return _bind_to(family, str(address[0]), 0)


def _bind_to(family: int, address: str, port: int) -> socket.socket:
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        if os.name == "posix":  # elsewhere it would let two servers share a port
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((address, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise RaystreamError(_bind_error(error, address, port)) from error
    return listener


def _bind_error(error: OSError, address: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"--port: {port} is in use on {address}; omit it to use any free port"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"--port: {port} requires privileges; choose one above 1023"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"--host: {address} is not an address of this machine"
    return f"--host, --port: cannot use {address}, port {port} ({error.strerror})"


class ViewServer:
    """Serves a render service at an address until it is closed.

    Runs in a daemon thread. A context manager.

    Parameters
    ----------
    service : RenderService
        Closed with the server.
    listener : socket
        From `bind`; closed with the server.
    host : str, optional
        The host as the user specified it.
    token : str, optional
        Token that browsers must present first. Generated if omitted and the address is not
        loopback: other addresses always require a token.
    upload_limit : int
        Maximum bytes of one upload, including all its files.

    Raises
    ------
    RaystreamError
        If the extra packages are not installed, or the token is too weak.
    """

    def __init__(
        self,
        service: RenderService,
        listener: socket.socket,
        *,
        host: str = "",
        token: str | None = None,
        upload_limit: int = DEFAULT_UPLOAD_LIMIT,
    ) -> None:
        self._service = service
        self._listener = listener
        self.address, self.port = listener.getsockname()[:2]
        try:
            self._access = Access(self.address, self.port, host=host, token=token)
            self._server, self._connections = _make_server(service, self._access, upload_limit)
        except BaseException:
            listener.close()
            service.close()
            raise
        self._started = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lock = threading.Lock()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="raystream-view", daemon=True)
        self._thread.start()
        self._started.wait()

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self._access.is_loopback

    @property
    def url(self) -> str:
        """Address of the page, including the token if there is one."""
        address = ipaddress.ip_address(self.address)
        if address.is_unspecified:
            return self._url(lan_address() or socket.gethostname().lower())
        return self._url(f"[{address}]" if address.version == 6 else str(address))

    @property
    def local_url(self) -> str:
        """The same for a browser on this machine."""
        is_any = ipaddress.ip_address(self.address).is_unspecified
        return self._url("localhost") if is_any else self.url

    def _url(self, host: str) -> str:
        query = "" if self._access.token is None else f"?token={self._access.token}"
        return f"http://{host}:{self.port}/{query}"

    @property
    def connection_count(self) -> int:
        """Number of live connections."""
        return len(self._connections)

    @property
    def is_running(self) -> bool:
        """Whether the server is running."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Block until the server stops; signals are still handled."""
        while self._thread.is_alive():
            self._thread.join(1.0)

    def close(self) -> None:
        """Close all connections, the server and the service. Idempotent."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
        self._close_connections()
        self._server.should_exit = True
        self._thread.join(2 * SHUTDOWN_TIMEOUT)
        self._service.close()

    def _close_connections(self) -> None:
        """Notify all clients, and give them a moment to receive it."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has already stopped
                self._loop.call_soon_threadsafe(self._connections.close)
        end = time.monotonic() + NOTIFY_TIMEOUT
        while self.connection_count and self.is_running and time.monotonic() < end:
            time.sleep(0.01)

    def __enter__(self) -> ViewServer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _run(self) -> None:
        try:
            with asyncio.Runner() as runner:
                runner.run(self._serve())
        finally:
            self._started.set()
            self._listener.close()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._started.set()
        await self._server.serve(sockets=[self._listener])


def lan_address() -> str | None:
    """Return this machine's address in its network; None without a network.

    That is the source address of a packet to another network. No packet is sent: the
    destination is reserved for documentation, and connecting a UDP socket sends nothing.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(("203.0.113.1", 9))
            found = str(asking.getsockname()[0])
        except OSError:  # no network
            return None
    return None if ipaddress.ip_address(found).is_unspecified else found


def require_packages() -> None:
    """Check that the packages of the extra are installed.

    Raises
    ------
    RaystreamError
        If one is missing.
    """
    for name in ("starlette", "uvicorn", "websockets"):
        if importlib.util.find_spec(name) is None:
            raise RaystreamError(f"the viewer needs {name}: pip install 'raystream[view]'")


def _make_server(
    service: RenderService, access: Access, upload_limit: int
) -> tuple[UvicornServer, Connections]:
    require_packages()
    import uvicorn

    from raystream.viewer.server.app import make_app
    from raystream.viewer.server.connections import Connections
    from raystream.viewer.server.protocol import MAX_MESSAGE_BYTES
    from raystream.viewer.server.transport import HttpProtocol, WebSocketProtocol

    connections = Connections(upload_limit)
    config = uvicorn.Config(
        make_app(service, connections, access),
        loop="asyncio",
        http=HttpProtocol,
        ws=WebSocketProtocol,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,  # images are compressed already; avoids decompression bombs
        lifespan="off",
        log_config=None,
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=SHUTDOWN_TIMEOUT,
    )
    return uvicorn.Server(config), connections
