"""What a user's function may do on CUDA: what has the CPU's bits there, and cannot fail.

NVIDIA's library has sines and powers of its own, whose last bits are others than those of the C
library; a remainder of floats is worked out roughly; a kernel that raises something just ends. The
code says which of these a function does, before it ever runs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from types import FunctionType, ModuleType
from typing import Any

from numba.core.dispatcher import Dispatcher

__all__ = ["CpuOnlyError", "check_calls", "check_options", "check_raises", "with_extremes"]


class CpuOnlyError(Exception):
    """A function that has to stay on the CPU; it says why."""


#: Functions of NVIDIA's library whose result IEEE 754 or integers leave no choice.
_EXACT = frozenset(
    [
        *(f"{name}{end}" for name in ("floor", "ceil", "trunc", "rint") for end in ("", "f")),
        *(f"{name}{end}" for name in ("fabs", "sqrt", "copysign", "fma") for end in ("", "f")),
        *(f"{name}{end}" for name in ("nearbyint", "round") for end in ("", "f")),
        *(f"{name}{end}" for name in ("isnan", "isinf", "signbit") for end in "fd"),
        *("isfinited", "finitef", "fsqrt_rn", "dsqrt_rn"),
        *("abs", "llabs", "min", "max", "umin", "umax", "llmin", "llmax", "ullmin", "ullmax"),
        *("popc", "popcll", "clz", "clzll", "brev", "brevll", "ffs", "ffsll"),
        *("mulhi", "umulhi", "mul64hi", "umul64hi"),
    ]
)

#: Likewise of LLVM's own.
_EXACT_LLVM = re.compile(
    r"llvm\.((fabs|copysign|floor|ceil|trunc|rint|round|roundeven|fma|abs|ctpop|ctlz|cttz|bswap|"
    r"bitreverse|[su](add|sub|mul)\.with\.overflow|[su]?(min|max))\.|memcpy|memset|memmove|"
    r"lifetime|assume|dbg|expect|nvvm\.read\.ptx\.sreg)"
)

_DECLARED = re.compile(r'^declare\s[^@]*@"?([^"(\s]+)"?\(', re.MULTILINE)
_DEFINED = re.compile(r'^define\s[^@]*@"?([^"(\s]+)"?\(', re.MULTILINE)
_LIBRARY = "__nv_"

#: The larger and the smaller of two numbers: NVIDIA's prefer a number to a NaN, and 0 to -0.
_EXTREMES = {
    "__nv_fmaxf": ("float", "ogt"),
    "__nv_fminf": ("float", "olt"),
    "__nv_fmax": ("double", "ogt"),
    "__nv_fmin": ("double", "olt"),
}
_EXTREME = """define internal {kind} @"{name}"({kind} %a, {kind} %b) alwaysinline {{
  %is = fcmp {order} {kind} %b, %a
  %chosen = select i1 %is, {kind} %b, {kind} %a
  ret {kind} %chosen
}}"""


def with_extremes(text: str) -> str:
    """A module's LLVM code with the CPU's `max` and `min` of two floats instead of NVIDIA's."""
    for name, (kind, order) in _EXTREMES.items():
        own = _EXTREME.format(name=name, kind=kind, order=order)
        text = re.sub(rf'^declare {kind} @"?{name}"?\(.*$', own, text, flags=re.MULTILINE)
    return text


def check_calls(modules: list[str]) -> None:
    """Look for what has other bits than on the CPU, or is not there.

    Parameters
    ----------
    modules : list of str
        LLVM code of a kernel, and of all that it calls.

    Raises
    ------
    CpuOnlyError
        If it calls anything whose bits are not known to be the CPU's.
    """
    defined = {name for text in modules for name in _DEFINED.findall(text)}
    for text in modules:
        for name in _DECLARED.findall(text):
            is_exact = name.removeprefix(_LIBRARY) in _EXACT and name.startswith(_LIBRARY)
            if not (name in defined or is_exact or _EXACT_LLVM.match(name)):
                raise CpuOnlyError(f"it calls {name.removeprefix(_LIBRARY)}")
        if re.search(r"= frem ", text):
            raise CpuOnlyError("it takes a remainder of floats")


def check_raises(ptx: str) -> None:
    """Look for the note that a kernel makes of an exception.

    Parameters
    ----------
    ptx : str
        Of a kernel that was made to take such notes.

    Raises
    ------
    CpuOnlyError
        If the compiler could not rule out that there is something to be noted.
    """
    body = ptx[ptx.index(".visible .entry") :]
    if re.search(r"__errcode__|__exc_helper__", body[: body.index("\n}")]):
        raise CpuOnlyError("it may raise an exception")
    if ".extern .func" in ptx:
        raise CpuOnlyError("it calls what the driver's library has, such as print")


def check_options(function: Callable[..., Any], options: dict[str, Any]) -> None:
    """Look for functions compiled with options that CUDA's compiler takes otherwise.

    Parameters
    ----------
    function : callable
    options : dict
        Those that make no difference.

    Raises
    ------
    CpuOnlyError
        If it, or one that it calls, was compiled with others.
    """
    for one in _reachable(function, set()):
        own = one.targetoptions
        if any(own.get(name, False) != value for name, value in options.items()):
            raise CpuOnlyError(f"{one.py_func.__name__} was compiled with options of its own")


def _reachable(value: object, met: set[int]) -> Iterator[Any]:
    """Compiled functions among what a function's names stand for, and so on down."""
    if id(value) in met:
        return
    met.add(id(value))
    if isinstance(value, Dispatcher):
        yield value
        yield from _reachable(value.py_func, met)
    elif isinstance(value, FunctionType):
        for cell in value.__closure__ or ():
            yield from _reachable(cell.cell_contents, met)
        names = value.__code__.co_names
        for name in names:
            found = value.__globals__.get(name)
            yield from _reachable(found, met)
            if isinstance(found, ModuleType):
                for attribute in names:
                    yield from _reachable(vars(found).get(attribute), met)
