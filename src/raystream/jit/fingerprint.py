"""A hash of all that a function's compiled code depends on, so that it can be kept on disk.

The cache's folder stands for raystream's own sources. A function from elsewhere is known by its
bytecode and by what its names stand for: numbers, arrays, other compiled functions and so on
down. Where that cannot be told, nothing is kept.
"""

from __future__ import annotations

import builtins
import dis
import enum
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import types
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic

__all__ = ["fingerprint"]

_PACKAGE = Path(__file__).parents[1]

#: Modules whose attributes are what their version says; raystream's are, too.
_KNOWN_MODULES = ("numpy", "math", "cmath", "operator", "numba")

_PLAIN = (bool, int, float, complex, str, bytes, type(None), type(Ellipsis))


class _UnknownError(Exception):
    """Something whose changes cannot be noticed."""


def fingerprint(function: Callable[..., Any]) -> str | None:
    """Hash a function with everything that its names stand for.

    Parameters
    ----------
    function : callable
        A Python function, or one compiled by Numba.

    Returns
    -------
    str or None
        32 hexadecimal digits; None if some of what it uses cannot be told, such as a class,
        an instance, or a module other than NumPy, ``math`` and raystream's.
    """
    try:
        text = _Reader().describe(function)
    except (_UnknownError, ValueError):  # ValueError: a variable from outside, not set yet
        return None
    text += f" python {sys.version_info[:2]} numpy {np.__version__}"
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]


class _Reader:
    """Describes values as text; a function that is met again is named by its number."""

    def __init__(self) -> None:
        self._met: dict[int, int] = {}

    def describe(self, value: object) -> str:
        if isinstance(value, Dispatcher):
            options = self._mapping(value.targetoptions)
            return f"compiled({options}, {self.describe(value.py_func)})"
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, enum.Enum):
            return f"{self._class(type(value))}.{value.name}"
        if isinstance(value, tuple | list | set | frozenset):
            parts = [self.describe(part) for part in value]
            if isinstance(value, set | frozenset):
                parts.sort()
            return f"{self._class(type(value))}({', '.join(parts)})"
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise _UnknownError
            digest = hashlib.sha256(value.tobytes()).hexdigest()
            return f"array({value.dtype.descr}, {value.shape}, {digest})"
        return self._leaf(value)

    def _leaf(self, value: object) -> str:
        if isinstance(value, np.generic):
            return f"{value.dtype.descr} {value.tobytes().hex()}"
        if type(value) in _PLAIN:
            return f"{type(value).__name__} {value!r}"
        if isinstance(value, CodeType):
            return self._code(value)
        if isinstance(value, np.dtype):
            return f"dtype {value.descr} {value.itemsize}"
        if isinstance(value, types.Type):
            return f"type {value}"
        if isinstance(value, ModuleType):
            name = value.__name__
            if name.partition(".")[0] in (*_KNOWN_MODULES, "raystream"):
                return f"module {name} {getattr(value, '__version__', '')}"
        if isinstance(value, BuiltinFunctionType | np.ufunc):
            return f"built-in {getattr(value, '__module__', None)}.{value.__name__}"
        if isinstance(value, _Intrinsic):
            return f"intrinsic {self.describe(value._defn)}"
        raise _UnknownError

    def _class(self, value: type) -> str:
        fields = getattr(value, "_fields", None)
        if fields is not None and issubclass(value, tuple):
            return f"named tuple {value.__name__}{fields}"
        if issubclass(value, enum.Enum):
            return f"enum {value.__name__} {self._mapping({m.name: m.value for m in value})}"
        if value.__module__.partition(".")[0] in ("builtins", *_KNOWN_MODULES):
            return f"class {value.__module__}.{value.__qualname__}"
        raise _UnknownError

    def _mapping(self, value: dict[str, Any]) -> str:
        return ", ".join(f"{key}={self.describe(part)}" for key, part in sorted(value.items()))

    def _function(self, function: FunctionType) -> str:
        if id(function) in self._met:
            return f"function {self._met[id(function)]}"
        self._met[id(function)] = len(self._met)
        module = str(function.__module__)
        cells = [self.describe(cell.cell_contents) for cell in function.__closure__ or ()]
        defaults = [self.describe(value) for value in function.__defaults__ or ()]
        if _is_own(function):
            name = f"{module}.{function.__qualname__} {defaults}"
        elif module.partition(".")[0] in _KNOWN_MODULES:
            return f"function {module}.{function.__qualname__}"
        else:
            more = self._mapping(function.__kwdefaults__ or {})
            used = {name: self._global(function, name) for name in _names(function.__code__)}
            name = f"{self._code(function.__code__)} {defaults} {more} {sorted(used.items())}"
        return f"function {name} {cells}"

    def _code(self, code: CodeType) -> str:
        constants = [self.describe(constant) for constant in code.co_consts]
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        arguments = (code.co_argcount, code.co_kwonlyargcount, code.co_flags)
        table = getattr(code, "co_exceptiontable", b"").hex()
        return f"code {code.co_code.hex()} {table} {names} {arguments} {constants}"

    def _global(self, function: FunctionType, name: str) -> str:
        if name in function.__globals__:
            return self.describe(function.__globals__[name])
        if hasattr(builtins, name):
            return "built-in"
        raise _UnknownError


def _names(code: CodeType) -> set[str]:
    """Global names that the code, and code inside it, reads."""
    names = {
        step.argval
        for step in dis.get_instructions(code)
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")
    }
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= _names(constant)
    return names


def _is_own(function: FunctionType) -> bool:
    """Whether the function is in one of raystream's files, all of which the folder stands for."""
    return Path(function.__code__.co_filename).is_relative_to(_PACKAGE)
