"""Protocol: parsing of a client's messages, and serialization of outgoing ones."""

from __future__ import annotations

import json
import math
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from raystream.viewer.messages import Frame

#: Longer messages close the connection before they are read.
MAX_MESSAGE_BYTES = 1 << 16

#: Maximum nesting of objects and lists; messages need three at most.
MAX_DEPTH = 8

#: Maximum digits of integers; no field needs more.
MAX_DIGITS = 15


class NotJsonError(Exception):
    """The text is not JSON: the connection is closed."""


class InvalidMessageError(Exception):
    """The text is JSON but not a valid message: the client receives a one-line error."""


def parse_message(text: str) -> dict[str, Any]:
    """Parse a message of a client.

    Parameters
    ----------
    text : str
        As received.

    Returns
    -------
    dict
        With a ``"type"`` that is a string. Its numbers are finite and its integers short;
        nothing else is checked.

    Raises
    ------
    NotJsonError
        If the text is not JSON; ``NaN`` and ``Infinity`` are not.
    InvalidMessageError
        If it is JSON, but not an object with a type, or exceeds a limit.
    """
    try:
        message = json.loads(
            text, parse_int=_integer, parse_float=_finite, parse_constant=_no_constant
        )
    except (ValueError, RecursionError):
        raise NotJsonError("expected JSON") from None
    if not isinstance(message, dict):
        raise InvalidMessageError("expected a JSON object")
    _require_shallow(message)
    if not isinstance(message.get("type"), str):
        raise InvalidMessageError("type: expected a string")
    return message


def _integer(digits: str) -> int:
    if len(digits) > MAX_DIGITS:
        raise InvalidMessageError(f"expected integers of at most {MAX_DIGITS} digits")
    return int(digits)


def _finite(digits: str) -> float:
    number = float(digits)
    if not math.isfinite(number):
        raise InvalidMessageError("expected finite numbers")
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
    raise InvalidMessageError(f"expected at most {MAX_DEPTH} levels of objects and lists")


def pack(message: dict[str, Any] | Frame) -> str | bytes:
    """Serialize a message as JSON, or a frame as its header and content.

    Parameters
    ----------
    message : dict or Frame
        NaN and infinities become null; NumPy scalars and arrays are accepted.

    Returns
    -------
    str or bytes
        Text for a message. For a frame, the header's length (uint32, little-endian), the
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
    """Convert a NumPy value to Python."""
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
