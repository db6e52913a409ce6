"""Loops that are written as text around a function, compiled, and kept on disk where possible."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from typing import Any

import numba
from numba.core.errors import NumbaError

from raystream.jit.cpu import device
from raystream.jit.fingerprint import fingerprint
from raystream.jit.from_source import kernel_from_source

__all__ = ["Loop", "as_device", "compile_loop", "fault"]


def as_device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a Python function for use in a loop; one that is compiled already stays."""
    return function if isinstance(function, numba.core.dispatcher.Dispatcher) else device(function)


class Loop:
    """A compiled loop. The first call for some types of arguments compiles it.

    Parameters
    ----------
    dispatcher : compiled function
    name : str
        The function around which it was written, for errors.
    is_kept : bool
        Whether its code is kept on disk.
    """

    def __init__(self, dispatcher: Any, name: str, is_kept: bool) -> None:
        self._dispatcher = dispatcher
        self._name = name
        self.is_kept = is_kept

    @property
    def compiled_count(self) -> int:
        """How often this process compiled it, rather than find it on disk."""
        return sum(self._dispatcher.stats.cache_misses.values())

    def __call__(self, *arguments: Any) -> Any:
        """Run it.

        Raises
        ------
        TypeError
            If the function cannot be compiled, with the reason.
        """
        try:
            return self._dispatcher(*arguments)
        except NumbaError as error:
            raise TypeError(f"{self._name}: {_reason(str(error))}") from error


_COMPILED: dict[tuple[Any, str], Loop] = {}

#: Loops that stay in memory; the oldest go.
_KEPT_LOOPS = 1024


def compile_loop(
    text: str, function: Callable[..., Any], names: Mapping[str, Any], module: str
) -> Loop:
    """Make a loop from text, or find it: functions that do the same share one.

    Parameters
    ----------
    text : str
        Defines a function ``loop``, which calls the user's as ``function``.
    function : callable
        The user's.
    names : mapping
        What else the text uses.
    module : str
        The module of raystream that wrote it.

    Notes
    -----
    What a function's names stand for is looked at here. A number that changes later is
    noticed when the next loop is made, not by this one.
    """
    key = fingerprint(function)
    place = (function if key is None else key, text)
    if place not in _COMPILED:
        while len(_COMPILED) >= _KEPT_LOOPS:
            del _COMPILED[next(iter(_COMPILED))]
        _COMPILED[place] = _new_loop(text, function, names, module, key)
    return _COMPILED[place]


def _new_loop(
    text: str,
    function: Callable[..., Any],
    names: Mapping[str, Any],
    module: str,
    key: str | None,
) -> Loop:
    digest = hashlib.sha256(f"{key} {text}".encode()).hexdigest()[:24]
    text = text.replace("def loop(", f"def loop_{digest}(")
    dispatcher = kernel_from_source(text, {"function": as_device(function), **names}, module)
    name = getattr(function, "__name__", "function")
    return Loop(dispatcher, name, fingerprint(dispatcher) is not None)


_MARKS = "«{}»"
_MARKED = re.compile("«(.*?)»", re.DOTALL)
_PLACE = re.compile(r'File "(.+)", line (\d+)')
_NOISE = ("Failed in", "During")
_ENDS = ('File "', "There are")


def fault(message: str) -> NumbaError:
    """The error by which code that runs at compile time tells the user what is wrong."""
    return numba.core.errors.TypingError(_MARKS.format(message))


def _reason(message: str) -> str:
    """What a user needs of Numba's message: ours if there is one, else the part on their code."""
    marked = _MARKED.search(message)
    if marked:
        return marked.group(1)
    own = message.split("During: resolving callee type")[0]
    place = _PLACE.search(own)
    kept = []
    for line in own.splitlines():
        if line.startswith(_ENDS):
            break
        if line.strip() and not line.startswith(_NOISE):
            kept.append(line.strip())
    at = f" ({place.group(1)}, line {place.group(2)})" if place else ""
    return f"Numba cannot compile it: {' '.join(kept)}{at}"
