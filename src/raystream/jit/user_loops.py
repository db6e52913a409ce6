"""Loops generated as source around users' functions, compiled, and cached on disk if possible."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping
from typing import Any

import numba
from numba.core.errors import NumbaError

from raystream.jit.cpu import user_device
from raystream.jit.fingerprint import fingerprint
from raystream.jit.from_source import kernel_from_source


def as_device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a Python function for use in a loop; compiled functions are returned as they are."""
    if isinstance(function, numba.core.dispatcher.Dispatcher):
        return function
    return user_device(function)


def checked_device(function: Callable[..., Any]) -> Any:
    """Compile a Python function that writes to arrays: an index beyond their end raises."""
    made: Any = user_device(getattr(function, "py_func", function))
    made.targetoptions["boundscheck"] = True
    return made


class Loop:
    """A compiled loop, compiled by the first call for each combination of argument types.

    Parameters
    ----------
    dispatcher : compiled function
    name : str
        Of the user's function, for errors.
    is_cached : bool
        Whether its code is cached on disk.
    """

    def __init__(self, dispatcher: Any, name: str, is_cached: bool) -> None:
        self._dispatcher = dispatcher
        self._name = name
        self.is_cached = is_cached
        self._addresses: dict[tuple[str, ...], int] = {}

    @property
    def compiled_count(self) -> int:
        """Number of compilations in this process: calls that did not find it on disk."""
        return sum(self._dispatcher.stats.cache_misses.values())

    def address_of(self, names: tuple[str, ...]) -> int:
        """The address of its code for some argument types; see `intrinsics.call_filter`.

        Parameters
        ----------
        names : tuple of str
            Of Numba's types.

        Raises
        ------
        TypeError
            See `__call__`.
        """
        known = self._addresses.get(names)  # Numba takes 70 us to find it
        if known is not None:
            return known
        types = tuple(getattr(numba.types, name) for name in names)
        try:
            self._dispatcher.compile(types)
        except NumbaError as error:
            raise TypeError(f"{self._name}: {_reason(str(error))}") from error
        except Exception as error:  # from inside Numba, such as a field that a record lacks
            reason = f"{type(error).__name__}: {error}"
            raise TypeError(f"{self._name}: Numba cannot compile it: {reason}") from error
        compiled = self._dispatcher.overloads[types]
        address = int(compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name))
        self._addresses[names] = address
        return address

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

#: Maximum number of loops in memory; the oldest are dropped.
_MAX_LOOPS = 1024


def compile_loop(
    text: str, function: Callable[..., Any], names: Mapping[str, Any], module: str
) -> Loop:
    """Make a loop from source, or find it: functions with the same fingerprint share one.

    Parameters
    ----------
    text : str
        Defines a function ``loop``, which calls the user's as ``function``.
    function : callable
        The user's.
    names : mapping
        Other globals of the text.
    module : str
        The module of raystream that generated it.

    Notes
    -----
    The globals of a function are read here. A number that changes later affects loops made after
    the change, not this one.
    """
    key = fingerprint(function)
    place = (function if key is None else key, text)
    if place not in _COMPILED:
        while len(_COMPILED) >= _MAX_LOOPS:
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
_LOCATION = re.compile(r'File "(.+)", line (\d+)')
_NOISE = ("Failed in", "During")
_ENDS = ('File "', "There are")


def fault(message: str) -> NumbaError:
    """A compile-time error whose message is for the user."""
    return numba.core.errors.TypingError(_MARKS.format(message))


def _reason(message: str) -> str:
    """Our message in Numba's, if there is one, else the part about the user's code."""
    marked = _MARKED.search(message)
    if marked:
        return marked.group(1)
    own = message.split("During: resolving callee type")[0]
    location = _LOCATION.search(own)
    lines = []
    for line in own.splitlines():
        if line.startswith(_ENDS):
            break
        if line.strip() and not line.startswith(_NOISE):
            lines.append(line.strip())
    at = f" ({location.group(1)}, line {location.group(2)})" if location else ""
    return f"Numba cannot compile it: {' '.join(lines)}{at}"
