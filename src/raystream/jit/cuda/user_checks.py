"""Checks that a user's function on CUDA has the CPU's bits and cannot raise an exception.

Sines and powers of NVIDIA's library differ from the C library's in the last bits; remainders of
floats are approximate; a kernel that raises an exception just ends. Compiled code shows all of
these before it runs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from types import FunctionType, ModuleType
from typing import Any

from numba.core.dispatcher import Dispatcher


class CpuOnlyError(Exception):
    """A function that must run on the CPU, with the reason."""


#: Functions of NVIDIA's library whose results are exact or fixed by IEEE 754.
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

#: The same of LLVM's intrinsics.
_EXACT_LLVM = re.compile(
    r"llvm\.((fabs|copysign|floor|ceil|trunc|rint|round|roundeven|fma|abs|ctpop|ctlz|cttz|bswap|"
    r"bitreverse|[su](add|sub|mul)\.with\.overflow|[su]?(min|max))\.|memcpy|memset|memmove|"
    r"lifetime|assume|dbg|expect|nvvm\.read\.ptx\.sreg)"
)

_DECLARED = re.compile(r'^declare\s[^@]*@"?([^"(\s]+)"?\(', re.MULTILINE)
_DEFINED = re.compile(r'^define\s[^@]*@"?([^"(\s]+)"?\(', re.MULTILINE)
_LIBRARY = "__nv_"

#: Maximum and minimum: NVIDIA's functions prefer a number to a NaN, and 0 to -0.
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
    """Replace NVIDIA's `max` and `min` of two floats in LLVM code by the CPU's."""
    for name, (kind, order) in _EXTREMES.items():
        own = _EXTREME.format(name=name, kind=kind, order=order)
        text = re.sub(rf'^declare {kind} @"?{name}"?\(.*$', own, text, flags=re.MULTILINE)
    return text


def check_calls(modules: list[str]) -> None:
    """Check that LLVM code calls only functions that have the CPU's bits.

    Parameters
    ----------
    modules : list of str
        LLVM code of a kernel and its callees.

    Raises
    ------
    CpuOnlyError
        If it calls any other function, or takes a remainder of floats.
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
    """Check that PTX does not record exceptions.

    Parameters
    ----------
    ptx : str
        Of a kernel compiled to record them.

    Raises
    ------
    CpuOnlyError
        If the compiler could not rule out an exception.
    """
    body = ptx[ptx.index(".visible .entry") :]
    if re.search(r"__errcode__|__exc_helper__", body[: body.index("\n}")]):
        raise CpuOnlyError("it may raise an exception")
    if ".extern .func" in ptx:
        raise CpuOnlyError("it calls a function of the driver, such as print")


def check_options(function: Callable[..., Any], options: dict[str, Any]) -> None:
    """Check that a function and its callees were compiled with given options.

    Parameters
    ----------
    function : callable
    options : dict
        Those with which CUDA's compiler gives the same results.

    Raises
    ------
    CpuOnlyError
        If it, or a callee, was compiled with others.
    """
    for one in _reachable(function, set()):
        own = one.targetoptions
        if any(own.get(name, False) != value for name, value in options.items()):
            raise CpuOnlyError(f"{one.py_func.__name__} was compiled with options of its own")


def _reachable(value: object, seen: set[int]) -> Iterator[Any]:
    """Compiled functions among the values of a function's names, recursively."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, Dispatcher):
        yield value
        yield from _reachable(value.py_func, seen)
    elif isinstance(value, FunctionType):
        for cell in value.__closure__ or ():
            yield from _reachable(cell.cell_contents, seen)
        names = value.__code__.co_names
        for name in names:
            found = value.__globals__.get(name)
            yield from _reachable(found, seen)
            if isinstance(found, ModuleType):
                for attribute in names:
                    yield from _reachable(vars(found).get(attribute), seen)
