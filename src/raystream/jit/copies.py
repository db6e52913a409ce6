"""Copies of compiled functions in which some of their callees are others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core.dispatcher import Dispatcher

_PACKAGE = Path(__file__).parents[1]


class Copies:
    """Makes copies of functions and of all that they call, each once.

    Parameters
    ----------
    suffix : str
        Of the copies' names.
    instead : mapping of compiled function to compiled function
        Replacements of callees.
    constant : callable, optional
        Replaces values of global names that are not compiled functions [default: keep them].
    """

    def __init__(
        self,
        suffix: str,
        instead: Mapping[Any, Any],
        constant: Callable[[Any], Any] = lambda value: value,
    ) -> None:
        self._suffix = suffix
        self._instead = instead
        self._constant = constant
        self._made: dict[Any, Any] = {}

    def of(self, function: Any) -> Any:
        """Copy a compiled function of raystream; the function itself, if nothing changes.

        Callees with global names are copied, too; attributes of modules are not.

        Raises
        ------
        TypeError
            If it is not compiled, or is a closure.
        """
        if not isinstance(function, Dispatcher):
            raise TypeError(f"function: expected a compiled one, got {type(function).__name__}")
        if function not in self._made:
            chosen: Any = self._instead.get(function, function)
            copy = self.python(chosen)
            if copy is not chosen.py_func:
                # The same compiler: that of device functions emits no machine code.
                options = {"pipeline_class": chosen._compiler.pipeline_class}
                chosen = numba.jit(**options, **chosen.targetoptions)(copy)
            self._made[function] = chosen
        return self._made[function]

    def python(self, dispatcher: Any) -> Any:
        """The copy's Python function, not compiled; the function itself, if nothing changes."""
        function = dispatcher.py_func
        if not Path(function.__code__.co_filename).is_relative_to(_PACKAGE):
            return function
        given = {
            name: function.__globals__[name]
            for name in function.__code__.co_names  # attributes, too, which do no harm
            if name in function.__globals__
        }
        made = {name: self._value(value) for name, value in given.items()}
        if all(made[name] is value for name, value in given.items()):
            return function
        if function.__closure__:
            raise TypeError(f"function: {function.__qualname__} is a closure")
        copy = FunctionType(
            function.__code__,
            {**function.__globals__, **made},
            f"{function.__name__}_{self._suffix}",
            function.__defaults__,
        )
        copy.__qualname__ = f"{function.__qualname__}_{self._suffix}"
        copy.__module__ = function.__module__
        return copy

    def _value(self, value: Any) -> Any:
        return self.of(value) if isinstance(value, Dispatcher) else self._constant(value)
