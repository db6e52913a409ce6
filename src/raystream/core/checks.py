"""Checks of arguments, with the name of the argument in the error."""

from __future__ import annotations

import math
import operator
from collections.abc import Collection
from typing import Any


def check_choice(name: str, value: object, choices: Collection[str]) -> None:
    """Raise ValueError if a value is not among these names."""
    if value not in choices:
        known = ", ".join(map(repr, choices))
        raise ValueError(f"{name}: expected one of {known}, got {value!r}")


def check_least(name: str, value: Any, least: int) -> int:
    """The value as an integer; ValueError if less than `least`, TypeError if not an integer."""
    number = operator.index(value)
    if number < least:
        raise ValueError(f"{name}: expected at least {least}, got {number}")
    return number


def check_finite(name: str, value: float) -> None:
    """Raise ValueError if a number is infinite or NaN."""
    if not math.isfinite(value):
        raise ValueError(f"{name}: expected a finite number, got {value}")
