"""Single-lane copies of functions of vectors: the CPU's source for a thread of a GPU.

A thread is a lane already: with 16 lanes each, threads would do 16 times the work in 16 times the
registers. So a function and its callees are compiled again, with vectors of one lane where the
source says 16. Lanes do not depend on each other, so the bits are the same.
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

#: Width of the vectors that become single lanes.
_WIDE = 16


@intrinsic
def lane_count(typing_context: Any, x: Any) -> Any:
    """Number of lanes of a vector, int64: for loops over lanes."""
    if not isinstance(x, VectorType):
        refuse("lane_count", "a vector", x)
    count = ir.Constant(ir.IntType(64), x.lane_count)
    return types.int64(x), lambda context, builder, signature, arguments: count


def single_lane(
    function: Callable[..., Any],
    instead: Mapping[Callable[..., Any], Callable[..., Any]] | None = None,
) -> Callable[..., Any]:
    """Copy a device function, with vectors of one lane instead of 16.

    Parameters
    ----------
    function : compiled function
        By `jit.cpu.device` or `device_call`, in a module of raystream. Callees with global names
        are copied, too; attributes of modules are not.
    instead : mapping, optional
        Replacements of callees, such as those that write to 16 places.

    Returns
    -------
    compiled function
        The function itself, if nothing changes.

    Raises
    ------
    TypeError
        If it is not compiled, or is a closure.
    """
    if not isinstance(function, Dispatcher):
        raise TypeError(f"function: expected a compiled one, got {type(function).__name__}")
    return _Copies(instead or {}).of(function)


class _Copies:
    """Makes each copy once."""

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
            raise TypeError(f"function: {function.__qualname__} is a closure")
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
