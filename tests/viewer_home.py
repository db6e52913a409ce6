"""A viewer server on a free local port, and clients that may misbehave."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path

from websockets.sync.client import connect

from fake_service import FakeService
from raystream.viewer.serve import ViewServer, bind
from raystream.viewer.server.page_files import PageFile

PAGE = {
    "index.html": PageFile(b"<!doctype html><title>page</title>", "text/html; charset=utf-8"),
    "large.js": PageFile(bytes(16 << 20), "text/javascript; charset=utf-8"),
    "view.js": PageFile(b"start()", "text/javascript; charset=utf-8"),
}

LIMIT = 1 << 20


def wait_until(condition, seconds=10.0):
    """Wait for something that the server does asynchronously."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.005)


class Guest:
    """Clients of a server on this machine.

    Parameters
    ----------
    port : int
    patience : float
        Seconds to wait for an answer.
    """

    def __init__(self, port, patience=10.0):
        self.port = port
        self.patience = patience
        self.name = f"127.0.0.1:{port}"
        self.origin = f"http://{self.name}"
        self._clients = ExitStack()

    def connect(self, origin="", headers=None, **options):
        """Open a websocket; ``client.hello`` is the server's first message."""
        client = self._clients.enter_context(
            connect(
                f"ws://{self.name}/live",
                origin=self.origin if origin == "" else origin,
                additional_headers=headers,
                proxy=None,
                close_timeout=1,
                max_size=None,
                **options,
            )
        )
        client.hello = json.loads(client.recv(10))
        return client

    def open_socket(self):
        """Open a connection and send nothing."""
        raw = self._clients.enter_context(socket.socket())
        # A receive buffer of this size; otherwise the system may make one for a whole scene.
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        raw.settimeout(self.patience)
        raw.connect(("127.0.0.1", self.port))
        return raw

    def ask(self, head, body=b""):
        """Send a request as it is, and read the answer: status, headers, body."""
        with socket.create_connection(("127.0.0.1", self.port), self.patience) as raw:
            raw.sendall(head.replace("\n", "\r\n").encode("latin-1") + b"\r\n\r\n" + body)
            return read_answer(raw)

    def get(self, path="/", **headers):
        """Request a path, with correct headers unless others are given; None omits one."""
        return self.request("GET", path, **headers)

    def request(self, method, path, body=b"", **headers):
        """The same with any method."""
        given = {"Host": self.name, "Connection": "close"}
        if body:
            given["Content-Length"] = str(len(body))
        given |= {name.replace("_", "-"): value for name, value in headers.items()}
        lines = [f"{name}: {value}" for name, value in given.items() if value is not None]
        return self.ask("\n".join([f"{method} {path} HTTP/1.1", *lines]), body)

    def put(self, client, path, body=b"v 0 0 0\n", **headers):
        """Upload a file for a connection."""
        given = {"Origin": self.origin, "X-Upload-Key": client.hello["upload_key"]} | headers
        return self.request("PUT", path, body, **given)

    def upgrade(self, **headers):
        """Request a websocket, with correct headers unless others are given; returns its status."""
        given = {"Connection": "Upgrade", "Upgrade": "websocket", "Origin": self.origin}
        given |= {"Sec_WebSocket_Key": "c3RyZWFtcyBvZiByYXlzIQ==", "Sec_WebSocket_Version": "13"}
        return self.get("/live", **given | headers)

    def leave(self):
        """End all connections."""
        self._clients.close()


class Home(Guest):
    """A server with a fake service, and its clients."""

    def __init__(self, host="127.0.0.1", **options):
        self.service = FakeService()
        options.setdefault("upload_limit", LIMIT)
        self.server = ViewServer(self.service, bind(host, 0), **options)
        super().__init__(self.server.port)

    def drop_clients(self):
        """Close everything that a test opened; afterwards the server holds nothing for it."""
        self.leave()
        wait_until(lambda: not self.service.present)
        wait_until(lambda: self.server.connection_count == 0)
        self.service.clients.clear()

    def close(self):
        self.drop_clients()
        self.server.close()
        assert not self.server.is_running
        assert self.service.is_closed


class Answer:
    def __init__(self, content):
        head, _, self.body = content.partition(b"\r\n\r\n")
        status, *lines = head.decode("latin-1").split("\r\n")
        self.status = int(status.split()[1]) if status else 0
        pairs = [line.partition(": ") for line in lines]
        self.headers = {name.lower(): value for name, _, value in pairs}


def read_answer(raw):
    """Read until the server ends the connection."""
    content = b""
    try:
        while chunk := raw.recv(65536):
            content += chunk
    except ConnectionResetError:  # it stopped reading
        pass
    return Answer(content)


def count_files():
    """Open files of this process, where the system reports them."""
    folder = Path("/proc/self/fd")
    return len(os.listdir(folder)) if folder.is_dir() else 0


def view_threads():
    """Threads of viewers; the library's tracing threads remain until the process ends."""
    return {
        thread
        for thread in threading.enumerate()
        if thread.name.startswith("raystream") and "view" in thread.name
    }


@contextmanager
def no_view_threads_left():
    """Afterwards there are no more of them than before: other tests' servers may be running."""
    before = view_threads()
    yield
    wait_until(lambda: view_threads() <= before)
