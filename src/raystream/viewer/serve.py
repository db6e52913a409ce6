"""Serve: a studio on an address of this machine, in a thread, with a clean end."""

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
from types import TracebackType
from typing import TYPE_CHECKING

from raystream.core.errors import RaystreamError
from raystream.viewer.server.access import Access

if TYPE_CHECKING:
    from uvicorn import Server as UvicornServer

    from raystream.viewer.server.visits import Visits
    from raystream.viewer.studio import Studio

__all__ = ["DEFAULT_UPLOAD_LIMIT", "PREFERRED_PORT", "ViewServer", "bind", "require_packages"]

#: The port that is tried first when none is asked for.
PREFERRED_PORT = 8008

#: Bytes of one upload, all its files together.
DEFAULT_UPLOAD_LIMIT = 256 << 20

#: Seconds that connections have to end when the server does; and that a page has, of these, to
#: hear why.
END_TIMEOUT = 5
GOODBYE_TIMEOUT = 1.0


def bind(host: str = "127.0.0.1", port: int | None = None) -> socket.socket:
    """Take an address of this machine.

    Parameters
    ----------
    host : str
        An address, or a name that has one.
    port : int, optional
        Without it, 8008, or any that is free.

    Returns
    -------
    socket
        Bound, not yet listening.

    Raises
    ------
    RaystreamError
        If there is no such address here, or the port is taken.
    """
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, UnicodeError):
        raise RaystreamError(f"--host: {host!r} is no address of this machine") from None
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
        raise RaystreamError(_why_not(error, address, port)) from error
    return listener


def _why_not(error: OSError, address: str, port: int) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"--port: {port} is in use on {address}; leave it out to take any that is free"
    if error.errno in (errno.EACCES, errno.EPERM):
        return f"--port: {port} may not be used by this user; choose one above 1023"
    if error.errno == errno.EADDRNOTAVAIL:
        return f"--host: {address} is no address of this machine"
    return f"--host, --port: cannot use {address}, port {port} ({error.strerror})"


class ViewServer:
    """A studio that can be reached at an address, until it is closed.

    It runs in a thread of its own, which ends with the process; a context manager.

    Parameters
    ----------
    studio : Studio
        Closed with the server.
    listener : socket
        From `bind`; closed with the server.
    host : str, optional
        What the user called the listener's address.
    token : str, optional
        What a browser must show first. Made if it is left out and the address is not the
        loopback one: no other can be used without a token.
    upload_limit : int
        Bytes of one upload, all its files together.

    Raises
    ------
    RaystreamError
        If the extra packages are not installed, or the token is too easy to guess.
    """

    def __init__(
        self,
        studio: Studio,
        listener: socket.socket,
        *,
        host: str = "",
        token: str | None = None,
        upload_limit: int = DEFAULT_UPLOAD_LIMIT,
    ) -> None:
        self._studio = studio
        self._listener = listener
        self.address, self.port = listener.getsockname()[:2]
        try:
            self._access = Access(self.address, self.port, host=host, token=token)
            self._server, self._visits = _make_server(studio, self._access, upload_limit)
        except BaseException:
            listener.close()
            studio.close()
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
        """Where a browser finds the page, with the token if there is one."""
        address = ipaddress.ip_address(self.address)
        if address.is_unspecified:
            return self._url(own_address() or socket.gethostname().lower())
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
    def visit_count(self) -> int:
        """How many are connected."""
        return len(self._visits)

    @property
    def is_running(self) -> bool:
        """Whether it can be reached."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Return when the server has ended; signals are handled meanwhile."""
        while self._thread.is_alive():
            self._thread.join(1.0)

    def close(self) -> None:
        """End all connections, the server and the studio; again has no effect."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
        self._send_away()
        self._server.should_exit = True
        self._thread.join(2 * END_TIMEOUT)
        self._studio.close()

    def _send_away(self) -> None:
        """Tell all that are connected, and give them a moment to hear it."""
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(self._visits.close)
        end = time.monotonic() + GOODBYE_TIMEOUT
        while self.visit_count and self.is_running and time.monotonic() < end:
            time.sleep(0.01)

    def __enter__(self) -> ViewServer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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


def own_address() -> str | None:
    """The address by which this machine is found in its network; None if there is none.

    It is the one that a packet to somewhere else would have. None is sent: the destination is
    an address for documentation, and UDP sends nothing before there is something to send.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            asking.connect(("203.0.113.1", 9))
            found = str(asking.getsockname()[0])
        except OSError:  # no network
            return None
    return None if ipaddress.ip_address(found).is_unspecified else found


def require_packages() -> None:
    """Find out whether the packages of the extra are there.

    Raises
    ------
    RaystreamError
        If one is not.
    """
    for name in ("starlette", "uvicorn", "websockets"):
        if importlib.util.find_spec(name) is None:
            raise RaystreamError(f"the viewer needs {name}: pip install 'raystream[view]'")


def _make_server(studio: Studio, access: Access, upload_limit: int) -> tuple[UvicornServer, Visits]:
    require_packages()
    import uvicorn

    from raystream.viewer.server.app import make_app
    from raystream.viewer.server.messages import MAX_MESSAGE_BYTES
    from raystream.viewer.server.transport import HttpProtocol, WebSocketProtocol
    from raystream.viewer.server.visits import Visits

    visits = Visits(upload_limit)
    config = uvicorn.Config(
        make_app(studio, visits, access),
        loop="asyncio",
        http=HttpProtocol,
        ws=WebSocketProtocol,
        ws_max_size=MAX_MESSAGE_BYTES,
        ws_per_message_deflate=False,  # pictures are packed, and a small message may unpack to much
        lifespan="off",
        log_config=None,
        proxy_headers=False,
        server_header=False,
        timeout_graceful_shutdown=END_TIMEOUT,
    )
    return uvicorn.Server(config), visits
