"""Connections: the live connections of a server, limited in number, and their resources."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from raystream.viewer.server.send_queue import SendQueue
from raystream.viewer.server.upload_folder import UploadFolder

if TYPE_CHECKING:
    from raystream.viewer.client import Client
    from raystream.viewer.messages import Frame

#: Maximum live connections; further ones are rejected.
MAX_CONNECTIONS = 32


class Connection:
    """One live connection.

    Parameters
    ----------
    send_queue : SendQueue
    uploads : UploadFolder

    Attributes
    ----------
    key : str
        Secret that authorizes uploads of this connection.
    client : Client or None
        Its counterpart in the engine, once it has joined.
    """

    def __init__(self, key: str, send_queue: SendQueue, uploads: UploadFolder) -> None:
        self.key = key
        self.send_queue = send_queue
        self.uploads = uploads
        self.client: Client | None = None

    def send(self, message: dict[str, Any] | Frame) -> None:
        """Send a message to the client, from any thread; hides upload paths in errors."""
        if isinstance(message, dict) and message.get("type") == "error":
            message = {**message, "message": self.uploads.without_paths(message["message"])}
        self.send_queue.put(message)

    def end(self) -> None:
        """Free its resources: its work in the engine, its messages, its files."""
        try:
            if self.client is not None:
                self.client.leave()
        finally:
            self.send_queue.close()
            self.uploads.remove()


class Connections:
    """The live connections of a server, used by its event loop only.

    Parameters
    ----------
    upload_limit : int
        Maximum bytes of one upload, including all its files.
    """

    def __init__(self, upload_limit: int) -> None:
        self.upload_limit = upload_limit
        self._connections: set[Connection] = set()
        self._is_open = True

    def __len__(self) -> int:
        return len(self._connections)

    @property
    def rejection(self) -> str:
        """Why new connections are rejected."""
        if self._is_open:
            return "too many connections to this viewer: try again later"
        return "the viewer was stopped"

    def begin(self, make_queue: Callable[[str], SendQueue]) -> Connection | None:
        """Accept a connection; None if the limit is reached.

        Parameters
        ----------
        make_queue : callable
            Called with the connection's key.
        """
        if not self._is_open or len(self._connections) >= MAX_CONNECTIONS:
            return None
        key = secrets.token_urlsafe(24)
        connection = Connection(key, make_queue(key), UploadFolder(self.upload_limit))
        self._connections.add(connection)
        return connection

    def end(self, connection: Connection) -> None:
        """Remove a connection."""
        try:
            connection.end()
        finally:
            self._connections.discard(connection)

    def find(self, key: str) -> Connection | None:
        """Find the connection of a key, in constant time per key."""
        found = None
        for connection in self._connections:
            if secrets.compare_digest(connection.key.encode(), key.encode()):
                found = connection
        return found

    def close(self) -> None:
        """Accept no more connections, and send all the reason of the shutdown."""
        self._is_open = False
        for connection in self._connections:
            connection.send_queue.finish({"type": "closing", "reason": "the viewer was stopped"})
