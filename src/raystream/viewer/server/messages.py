"""Messages: what a client may send, and how what it is sent becomes bytes."""

from __future__ import annotations

import json
import math
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from raystream.viewer.messages import Frame

__all__ = [
    "MAX_MESSAGE_BYTES",
    "MalformedError",
    "UnusableError",
    "pack",
    "parse_message",
]

#: A longer message ends the connection before it is read.
MAX_MESSAGE_BYTES = 1 << 16

#: How deep objects and lists may lie in each other: no message needs more than three.
MAX_DEPTH = 8

#: Whole numbers of more digits are beyond what a field could mean.
MAX_DIGITS = 15


class MalformedError(Exception):
    """Not JSON at all: the connection ends."""


class UnusableError(Exception):
    """JSON, but no message: the client is told so, in one line."""


def parse_message(text: str) -> dict[str, Any]:
    """Read a message of a client.

    Parameters
    ----------
    text : str
        As it came.

    Returns
    -------
    dict
        With a ``"type"`` that is text. Its numbers are finite and its integers short; nothing
        else is checked.

    Raises
    ------
    MalformedError
        If the text is not JSON; ``NaN`` and ``Infinity`` are not.
    UnusableError
        If it is, but not an object with a type, or out of all proportion.
    """
    try:
        message = json.loads(
            text, parse_int=_integer, parse_float=_finite, parse_constant=_no_constant
        )
    except (ValueError, RecursionError):
        raise MalformedError("expected JSON") from None
    if not isinstance(message, dict):
        raise UnusableError("expected a JSON object")
    _require_shallow(message)
    if not isinstance(message.get("type"), str):
        raise UnusableError("type: expected text")
    return message


def _integer(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise UnusableError(f"expected integers of at most {MAX_DIGITS} digits")
    return int(digits)


def _finite(digits: str) -> float:
    number = float(digits)
    if not math.isfinite(number):
        raise UnusableError("expected finite numbers")
    return number


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _require_shallow(message: dict[str, Any]) -> None:
    level: list[Any] = [message]
    for _ in range(MAX_DEPTH):
        children: list[Any] = []
        for value in level:
            children += value.values() if isinstance(value, dict) else value
        level = [value for value in children if isinstance(value, dict | list)]
        if not level:
            return
    raise UnusableError(f"expected at most {MAX_DEPTH} levels of objects and lists")


def pack(message: dict[str, Any] | Frame) -> str | bytes:
    """Make what goes over the wire: JSON of a message, or a frame's header and content.

    Parameters
    ----------
    message : dict or Frame
        Numbers that JSON does not have become null; NumPy's scalars and arrays are taken, too.

    Returns
    -------
    str or bytes
        Text for a message. For a frame the header's length (uint32, little-endian), the
        header as JSON, and the content.
    """
    if isinstance(message, dict):
        return _json(message)
    header = _json(message.header).encode()
    return b"".join((struct.pack("<I", len(header)), header, message.content))


def _json(value: dict[str, Any]) -> str:
    try:
        return json.dumps(value, allow_nan=False, separators=(",", ":"), default=_plain)
    except ValueError:
        value = _without_nan(value)
        return json.dumps(value, allow_nan=False, separators=(",", ":"), default=_plain)


def _plain(value: Any) -> Any:
    """What a value of NumPy is in Python."""
    if isinstance(value, np.generic | np.ndarray):
        return _without_nan(value.tolist())
    raise TypeError(f"{type(value).__name__} has no JSON")


def _without_nan(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(one) for one in value]
    return value
