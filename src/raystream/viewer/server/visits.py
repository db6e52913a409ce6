"""Visits: who is connected, bounded, and what belongs to each."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from raystream.viewer.server.outbox import Outbox
from raystream.viewer.server.upload_folder import UploadFolder

if TYPE_CHECKING:
    from raystream.viewer.messages import Frame
    from raystream.viewer.visitor import Visitor

__all__ = ["MAX_VISITS", "Visit", "Visits"]

#: Connections at once; more are told to come again.
MAX_VISITS = 32


class Visit:
    """One live connection.

    Parameters
    ----------
    outbox : Outbox
    uploads : UploadFolder

    Attributes
    ----------
    key : str
        What uploads of this connection carry; nobody else knows it.
    visitor : Visitor or None
        Its side in the engine, once it has joined.
    """

    def __init__(self, key: str, outbox: Outbox, uploads: UploadFolder) -> None:
        self.key = key
        self.outbox = outbox
        self.uploads = uploads
        self.visitor: Visitor | None = None

    def tell(self, message: dict[str, Any] | Frame) -> None:
        """Send the client a message, from any thread; where its files lie is not its concern."""
        if isinstance(message, dict) and message.get("type") == "error":
            message = {**message, "message": self.uploads.without_place(message["message"])}
        self.outbox.put(message)

    def end(self) -> None:
        """Free what it holds: its work in the engine, its messages, its files."""
        try:
            if self.visitor is not None:
                self.visitor.leave()
        finally:
            self.outbox.close()
            self.uploads.remove()


class Visits:
    """The live connections of a server, used by its event loop only.

    Parameters
    ----------
    upload_limit : int
        Bytes that one upload may have, all its files together.
    """

    def __init__(self, upload_limit: int) -> None:
        self.upload_limit = upload_limit
        self._visits: set[Visit] = set()
        self._is_open = True

    def __len__(self) -> int:
        return len(self._visits)

    @property
    def refusal(self) -> str:
        """Why nobody can come in, when nobody can."""
        if self._is_open:
            return "too many are connected to this viewer: try again later"
        return "the viewer has ended"

    def begin(self, make_outbox: Callable[[str], Outbox]) -> Visit | None:
        """Let one in; None when as many as there may be are there.

        Parameters
        ----------
        make_outbox : callable
            Given the visit's key.
        """
        if not self._is_open or len(self._visits) >= MAX_VISITS:
            return None
        key = secrets.token_urlsafe(24)
        visit = Visit(key, make_outbox(key), UploadFolder(self.upload_limit))
        self._visits.add(visit)
        return visit

    def end(self, visit: Visit) -> None:
        """Let one go."""
        try:
            visit.end()
        finally:
            self._visits.discard(visit)

    def of_key(self, key: str) -> Visit | None:
        """Find the visit that has a key, in a time that tells nothing of the keys."""
        found = None
        for visit in self._visits:
            if secrets.compare_digest(visit.key.encode(), key.encode()):
                found = visit
        return found

    def close(self) -> None:
        """Let nobody in any more, and say to all why the connection ends."""
        self._is_open = False
        for visit in self._visits:
            visit.outbox.finish({"type": "closing", "reason": "the viewer has ended"})
