"""Arithmetic instructions of PTX: each reads registers of a frame, and writes one."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from ptx.memory import PtxError
from ptx.numbers import fused, is_float, larger, signed, smaller, width_of
from ptx.slots import Slots

#: Changes a frame.
Step = Callable[[list[Any]], Any]


def _whole(function: Callable[..., int]) -> Callable[..., Any]:
    """Makes steps of a function of integers without sign, or with one where the type has it."""

    def make(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
        kind = words[-1]
        width, mask = width_of(kind), (1 << width_of(kind)) - 1
        to = slots.of(operands[0], kind)
        places = [slots.of(text, kind) for text in operands[1:]]
        if kind[0] == "s":

            def step(f):
                f[to] = function(*[signed(f[at] & mask, width) for at in places]) & mask

        else:

            def step(f):
                f[to] = function(*[f[at] & mask for at in places]) & mask

        return step

    return make


def _either(whole: Callable[..., Any], fraction: Callable[..., Any]) -> Callable[..., Any]:
    """Makes steps of a function of integers, or of floats; rounding must be to nearest."""
    of_integers = _whole(whole)

    def make(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
        kind = words[-1]
        if not is_float(kind):
            return of_integers([word for word in words if word != "lo"], operands, slots)
        _check_rounding(words)
        to = slots.of(operands[0], kind)
        places = [slots.of(text, kind) for text in operands[1:]]
        made = fraction(kind) if isinstance(fraction, _OfKind) else fraction
        if len(places) == 1:
            (a,) = places

            def step(f):
                f[to] = made(f[a])

        elif len(places) == 2:
            a, b = places

            def step(f):
                f[to] = made(f[a], f[b])

        else:
            a, b, c = places

            def step(f):
                f[to] = made(f[a], f[b], f[c])

        return step

    return make


class _OfKind:
    """A function that depends on the type."""

    def __init__(self, made: Callable[[str], Callable[..., Any]]) -> None:
        self._made = made

    def __call__(self, kind: str) -> Callable[..., Any]:
        return self._made(kind)


_ROUNDED = ("add", "sub", "mul", "fma", "div", "rcp", "sqrt")


def _check_rounding(words: list[str]) -> None:
    """Neither flushed nor approximate: no other modifiers between name and type."""
    for word in words[:-1]:
        if word not in ("rn",):
            raise PtxError(f"'.{word}' would round in another way than the CPU")


def _float_of(name: str, whole: Callable[..., Any], fraction: Any) -> Callable[..., Any]:
    """Like `_either`, but floats must state rounding to nearest, or they may be fused."""
    make = _either(whole, fraction)

    def checked(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
        if is_float(words[-1]) and name in _ROUNDED and "rn" not in words:
            raise PtxError(f"{name} without '.rn' may be fused with others")
        return make(words, operands, slots)

    return checked


def _multiplied(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    if "wide" in words:
        return _widened(words, operands, slots, lambda a, b: a * b)
    if "hi" in words:
        width = width_of(words[-1])
        return _whole(lambda a, b: (a * b) >> width)(words, operands, slots)
    return _float_of("mul", operator.mul, operator.mul)(words, operands, slots)


def _multiplied_and_added(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    if "wide" in words:
        return _widened(words, operands, slots, lambda a, b, c: a * b + c)
    return _either(lambda a, b, c: a * b + c, None)(words, operands, slots)


def _widened(words, operands, slots, function) -> Step:
    """A product twice as wide as its factors."""
    kind = words[-1]
    width = width_of(kind)
    narrow, wide = (1 << width) - 1, (1 << 2 * width) - 1
    to, a, b, *more = (slots.of(text, f"{kind[0]}{2 * width}") for text in operands)
    has_sign = kind[0] == "s"

    def step(f):
        x, y = f[a] & narrow, f[b] & narrow
        if has_sign:
            x, y = signed(x, width), signed(y, width)
        f[to] = function(x, y, *[f[at] for at in more]) & wide

    return step


def _quotient(a: int, b: int) -> int:
    sign = -1 if (a < 0) != (b < 0) else 1
    return sign * (abs(a) // abs(b))


def _remainder(a: int, b: int) -> int:
    return a - b * _quotient(a, b)


def _shift(is_left: bool) -> Callable[..., Any]:
    def make(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
        kind = words[-1]
        width, mask = width_of(kind), (1 << width_of(kind)) - 1
        to, a = (slots.of(text, kind) for text in operands[:2])
        by = slots.of(operands[2], "b32")
        has_sign = kind[0] == "s"

        def step(f):
            n = min(f[by] & 0xFFFFFFFF, width)
            x = f[a] & mask
            if is_left:
                f[to] = (x << n) & mask
            else:
                f[to] = ((signed(x, width) if has_sign else x) >> n) & mask

        return step

    return make


def _logic(function: Callable[..., Any]) -> Callable[..., Any]:
    of_integers = _whole(function)

    def make(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
        if words[-1] != "pred":
            return of_integers(words, operands, slots)
        to, *places = (slots.of(text, "pred") for text in operands)

        def step(f):
            f[to] = bool(function(*[f[at] for at in places]) & 1)

        return step

    return make


def _inserted(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    def insert(field: int, base: int, position: int, length: int) -> int:
        bits = ((1 << (length & 0xFF)) - 1) << (position & 0xFF)
        return (base & ~bits) | ((field << (position & 0xFF)) & bits)

    return _whole(insert)(words, operands, slots)


def _lost(a: Any, b: Any) -> Any:
    return type(a)(math.copysign(b, a))


def _counted(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    """Zeros before the first bit that is set."""
    width = width_of(words[-1])
    return _whole(lambda a: width - a.bit_length())(words, operands, slots)


def _funnel(words: list[str], operands: tuple[str, ...], slots: Slots) -> Step:
    """A shift of two registers as one, of which half is kept."""
    low_first, wraps = words[0] == "r", words[1] == "wrap"

    def shift(a: int, b: int, count: int) -> int:
        count = count % 32 if wraps else min(count, 32)
        both = b << 32 | a
        return both >> count if low_first else (both << count) >> 32

    return _whole(shift)(words, operands, slots)


MAKERS = {
    "abs": _either(abs, np.abs),
    "add": _float_of("add", operator.add, operator.add),
    "and": _logic(operator.and_),
    "bfi": _inserted,
    "copysign": _either(None, _lost),
    "clz": _counted,
    "div": _float_of("div", _quotient, np.divide),
    "fma": _float_of("fma", None, _OfKind(fused)),
    "mad": _multiplied_and_added,
    "max": _either(max, larger),
    "min": _either(min, smaller),
    "mul": _multiplied,
    "neg": _either(operator.neg, operator.neg),
    "not": _logic(operator.invert),
    "or": _logic(operator.or_),
    "popc": _whole(lambda a: a.bit_count()),
    "rcp": _float_of("rcp", None, lambda a: type(a)(1.0) / a),
    "rem": _either(_remainder, None),
    "shl": _shift(is_left=True),
    "shr": _shift(is_left=False),
    "shf": _funnel,
    "sqrt": _float_of("sqrt", None, np.sqrt),
    "sub": _float_of("sub", operator.sub, operator.sub),
    "xor": _logic(operator.xor),
}
