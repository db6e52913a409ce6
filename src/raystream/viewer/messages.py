"""Messages between a visitor's page and the studio: what goes out, and checks of what comes in."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

__all__ = [
    "Frame",
    "Message",
    "MessageError",
    "Send",
    "error_text",
    "finite_or_none",
    "read_choice",
    "read_flag",
    "read_number",
    "read_triple",
    "read_whole",
]

#: A JSON object; ``"type"`` says what it is.
Message = dict[str, Any]


class Frame(NamedTuple):
    """A picture on its way to a page.

    Attributes
    ----------
    header : dict
        What is known of it, for JSON.
    content : bytes
        A JPEG or PNG file.
    """

    header: Message
    content: bytes


#: How a visitor is reached. It is called from the studio's threads, and must return at once.
Send = Callable[[Message | Frame], None]


class MessageError(ValueError):
    """A message that cannot be used: one line that names the field and says what it should be."""


def read_number(
    message: Mapping[str, Any], name: str, low: float, high: float, *, above: bool = False
) -> float:
    """A number of a message.

    Parameters
    ----------
    message : mapping
    name : str
        Of the field.
    low, high : float
        Between which it must be; both are allowed, but for `low` if `above`.
    above : bool

    Raises
    ------
    MessageError
        If the field is missing, no number, or out of range.
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


def read_whole(message: Mapping[str, Any], name: str, low: int, high: int) -> int:
    """An integer of a message, from `low` to `high`; see `read_number`."""
    value = _field(message, name)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise MessageError(f"{name}: expected an integer from {low} to {high}, got {value!r:.40}")
    return value


def read_triple(message: Mapping[str, Any], name: str) -> tuple[float, float, float]:
    """Three finite numbers of a message; see `read_number`."""
    value = _field(message, name)
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise MessageError(f"{name}: expected three numbers, got {value!r:.40}")
    most = 1e30  # as far as distances can still be squared
    x, y, z = (read_number({name: part}, name, -most, most) for part in value)
    return x, y, z


def read_flag(message: Mapping[str, Any], name: str) -> bool:
    """True or false of a message; see `read_number`."""
    value = _field(message, name)
    if not isinstance(value, bool):
        raise MessageError(f"{name}: expected true or false, got {value!r:.40}")
    return value


def read_choice(message: Mapping[str, Any], name: str, names: Collection[str]) -> str:
    """One of some names of a message; see `read_number`."""
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
    """What an error says, in one line that is never empty nor endless."""
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError):
        text = f"out of memory: {text}" if text else "out of memory"
    return f"{text or type(error).__name__:.500}"


def finite_or_none(number: float) -> float | None:
    """A number for JSON, which knows neither infinity nor NaN: None for these."""
    number = float(number)
    return number if math.isfinite(number) else None
