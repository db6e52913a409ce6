"""Options of `Tracer` on the command line: ``KEY=VALUE``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from raystream.cli.messages import BadInputError

__all__ = ["parse_keywords", "tracer_options"]


def parse_keywords(where: str, words: Sequence[str]) -> dict[str, Any]:
    """Read ``key=value``; a value is a number, a list, true, false or null, else text.

    Raises
    ------
    BadInputError
        If a word is none, or its key is not for the command line.
    """
    parsed: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.strip().partition("=")
        if not equals or not key.isidentifier():
            raise BadInputError(f"{where}: expected KEY=VALUE, got {word!r}")
        if key in ("scene", "progress"):
            raise BadInputError(f"{where}: {key} cannot be chosen")
        try:
            parsed[key] = json.loads(value)
        except (ValueError, RecursionError):
            parsed[key] = value
    return parsed


def tracer_options(words: Sequence[str], traversal: str | None) -> dict[str, Any]:
    """Options of `Tracer` from ``--option`` and ``--traversal``.

    Raises
    ------
    BadInputError
        If they contradict each other, or have options of their own.
    """
    parsed = parse_keywords("--option", words)
    for key in ("structure", "device"):
        if key in parsed:
            raise BadInputError(f"--option: give {key} as --{key}")
    if traversal is not None and parsed.setdefault("traversal", traversal) != traversal:
        raise BadInputError("--option: another traversal than --traversal")
    return parsed
