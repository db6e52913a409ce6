"""Access: by which names a viewer may be asked for, and with which token."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket

from raystream.core.errors import RaystreamError

__all__ = ["Access", "make_token"]

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})

#: What a token that somebody chose must be: too long to be guessed, and free of signs that mean
#: something in an address or a cookie.
_TOKEN = re.compile(r"[A-Za-z0-9_-]{16,256}")

#: ``name:port``, ``1.2.3.4:port`` or ``[::1]:port``, the port left out or not.
_HOST = re.compile(r"(?:\[(?P<v6>[0-9a-fA-F:.]+)\]|(?P<name>[A-Za-z0-9_.-]+))(?::\d{1,5})?")


def make_token(chosen: str | None = None) -> str:
    """Check a token that somebody chose, or make one of 256 random bits.

    Raises
    ------
    RaystreamError
        If it is too short, or has other signs than letters, digits, ``-`` and ``_``.
    """
    if chosen is None:
        return secrets.token_urlsafe(32)
    if _TOKEN.fullmatch(chosen) is None:
        raise RaystreamError(
            "--token: expected 16 to 256 letters, digits, - or _; without it one is made where "
            "it is needed"
        )
    return chosen


class Access:
    """Who may ask a server that is bound to an address.

    Parameters
    ----------
    address : str
        The IP address that the server is bound to.
    port : int
    host : str
        What the user called the address: one more name that is right.
    token : str, optional
        Asked for on the loopback address too when given. On other addresses there is always
        one: without it, it is made.

    Attributes
    ----------
    is_loopback : bool
        Whether only this machine can reach the address.
    token : str or None
        What the first request must show.
    cookie_name, session : str
        The cookie that shows, after that, that the token was known. Cookies know no ports: the
        name has the port in it.
    """

    def __init__(self, address: str, port: int, *, host: str = "", token: str | None = None):
        bound = ipaddress.ip_address(address)
        self.is_loopback = bound.is_loopback
        self._takes_any_address = bound.is_unspecified
        self._names = {address.lower(), host.lower()} - {""}
        if self.is_loopback or self._takes_any_address:
            self._names |= LOOPBACK_NAMES
        if not self.is_loopback:
            own = socket.gethostname().lower()
            self._names |= {own, f"{own.partition('.')[0]}.local"}
        self.token = make_token(token) if token is not None or not self.is_loopback else None
        self.cookie_name = f"raystream_{port}"
        self.session = secrets.token_urlsafe(32)

    def knows_host(self, host: str) -> bool:
        """Whether a request's ``Host`` names this server.

        A page of somebody else's name that is made to point here (DNS rebinding) asks with that
        name. An IP address cannot be made to point elsewhere, so a server on all addresses takes
        any. The port may be another one, as tunnels have it.
        """
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        name = (match["v6"] or match["name"]).lower().removesuffix(".")
        if name in self._names:
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return False
        return self._takes_any_address or str(address) in self._names

    def knows_token(self, given: str) -> bool:
        """Whether this is the token; takes as long for a near miss as for any other."""
        return self.token is not None and _are_equal(given, self.token)

    def knows_session(self, given: str) -> bool:
        """Whether this is the cookie's value."""
        return _are_equal(given, self.session)


def _are_equal(given: str, expected: str) -> bool:
    return secrets.compare_digest(given.encode("utf-8", "replace"), expected.encode())
