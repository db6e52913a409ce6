"""Messages between a page and the render service: types, and validation of incoming fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

#: A JSON object; ``"type"`` names its kind.
Message = dict[str, Any]


class Frame(NamedTuple):
    """An encoded image for a page.

    Attributes
    ----------
    header : dict
        Metadata, for JSON.
    content : bytes
        A JPEG or PNG file.
    """

    header: Message
    content: bytes


#: Sends to a client. Called from the service's threads; must return at once.
Send = Callable[[Message | Frame], None]


class MessageError(ValueError):
    """An invalid message: one line that names the field and the expected value."""


def read_number(
    message: Mapping[str, Any], name: str, low: float, high: float, *, above: bool = False
) -> float:
    """Read a number from a message.

    Parameters
    ----------
    message : mapping
    name : str
        Name of the field.
    low, high : float
        Closed range of valid values; `low` itself is excluded if `above`.
    above : bool

    Raises
    ------
    MessageError
        If the field is missing, not a number, or out of range.
    """
    value = _field(message, name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MessageError(f"{name}: expected a number, got {value!r:.40}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not (low <= number <= high) or not math.isfinite(number) or (above and number == low):
        bounds = f"above {low:g} and up to {high:g}" if above else f"from {low:g} to {high:g}"
        raise MessageError(f"{name}: expected a number {bounds}, got {value!r:.40}")
    return number


def read_integer(message: Mapping[str, Any], name: str, low: int, high: int) -> int:
    """Read an integer from `low` to `high` from a message; see `read_number`."""
    value = _field(message, name)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise MessageError(f"{name}: expected an integer from {low} to {high}, got {value!r:.40}")
    return value


def read_vector(message: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    """Read three finite numbers from a message; see `read_number`."""
    value = _field(message, name)
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise MessageError(f"{name}: expected three numbers, got {value!r:.40}")
    most = 1e30  # so that squared distances stay finite
    x, y, z = (read_number({name: part}, name, -most, most) for part in value)
    return x, y, z


def read_bool(message: Mapping[str, Any], name: str) -> bool:
    """Read a boolean from a message; see `read_number`."""
    value = _field(message, name)
    if not isinstance(value, bool):
        raise MessageError(f"{name}: expected true or false, got {value!r:.40}")
    return value


def read_choice(message: Mapping[str, Any], name: str, names: Collection[str]) -> str:
    """Read one of several names from a message; see `read_number`."""
    value = _field(message, name)
    if not isinstance(value, str) or value not in names:
        known = ", ".join(map(repr, names))
        raise MessageError(f"{name}: expected one of {known}, got {value!r:.40}")
    return value


def _field(message: Mapping[str, Any], name: str) -> Any:
    if name not in message:
        raise MessageError(f"{name}: is missing")
    return message[name]


def error_text(error: BaseException) -> str:
    """Return an error's message as one line of limited length, never empty."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        text = f"out of memory: {text}" if text else "out of memory"
    return f"{text or type(error).__name__:.500}"


def finite_or_none(number: float) -> float | None:
    """Convert a number for JSON: None for infinity and NaN, which JSON lacks."""
    number = float(number)
    return number if math.isfinite(number) else None
