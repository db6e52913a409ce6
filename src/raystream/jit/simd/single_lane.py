"""Functions of vectors, made functions of one lane: the same source, for a thread of a GPU.

A thread is a lane already: with 16 in each, it would do 16 times the work, in 16 times the
registers. So what a function calls is compiled once more with vectors of one lane where the source
says 16. Each lane of a vector has the bits that it has by itself, and so has this one.
"""

from __future__ import annotations

import dis
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic

from raystream.jit.simd.types import VECTORS, VectorType, refuse

__all__ = ["lane_count", "single_lane"]

_PACKAGE = Path(__file__).parents[2]

#: Lanes that become one.
_WIDE = 16


@intrinsic
def lane_count(typing_context: Any, x: Any) -> Any:
    """How many lanes a vector has, int64: for loops over them."""
    if not isinstance(x, VectorType):
        refuse("lane_count", "a vector", x)
    count = ir.Constant(ir.IntType(64), x.lane_count)
    return types.int64(x), lambda context, builder, signature, arguments: count


def single_lane(
    function: Callable[..., Any],
    instead: Mapping[Callable[..., Any], Callable[..., Any]] | None = None,
) -> Callable[..., Any]:
    """A device function with vectors of one lane instead of 16.

    Parameters
    ----------
    function : compiled function
        By `jit.cpu.device` or `device_call`, of a module of raystream. What it calls is made so,
        too, if its name is a global one; functions that it finds in a module stay as they are.
    instead : mapping, optional
        What is called in place of others, such as of those that write to 16 places.

    Returns
    -------
    compiled function
        The same one, if there is nothing to change.

    Raises
    ------
    TypeError
        If it is not compiled, or has variables from outside.
    """
    if not isinstance(function, Dispatcher):
        raise TypeError(f"function: expected a compiled one, got {type(function).__name__}")
    return _Copies(instead or {}).of(function)


class _Copies:
    """Copies of functions, each made once."""

    def __init__(self, instead: Mapping[Any, Any]) -> None:
        self._instead = instead
        self._made: dict[Any, Any] = {}

    def of(self, function: Any) -> Any:
        if function not in self._made:
            self._made[function] = self._copy(self._instead.get(function, function))
        return self._made[function]

    def _copy(self, dispatcher: Any) -> Any:
        function = dispatcher.py_func
        if not Path(function.__code__.co_filename).is_relative_to(_PACKAGE):
            return dispatcher
        given = {
            name: function.__globals__[name]
            for name in _global_names(function)
            if name in function.__globals__
        }
        made = {name: self._value(value) for name, value in given.items()}
        if all(made[name] is value for name, value in given.items()):
            return dispatcher
        if function.__closure__:
            raise TypeError(f"function: {function.__qualname__} has variables from outside")
        copy = FunctionType(
            function.__code__,
            {**function.__globals__, **made},
            function.__name__,
            function.__defaults__,
        )
        copy.__qualname__ = f"{function.__qualname__}_of_one_lane"
        copy.__module__ = function.__module__
        return numba.jit(**dispatcher.targetoptions)(copy)

    def _value(self, value: Any) -> Any:
        if isinstance(value, VectorType) and value.lane_count == _WIDE:
            return VECTORS[value.kind, 1]
        return self.of(value) if isinstance(value, Dispatcher) else value


def _global_names(function: FunctionType) -> set[str]:
    return {step.argval for step in dis.get_instructions(function) if step.opname == "LOAD_GLOBAL"}
