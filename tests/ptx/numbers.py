"""PTX numbers: integers are kept unsigned, in the width of their register.

Floats are NumPy's, so that each operation rounds once, as IEEE 754 says.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import operator

import numpy as np

_C = ctypes.CDLL(ctypes.util.find_library("m"))
_FMA = {}
for _name, _kind, _made in (("fmaf", ctypes.c_float, np.float32), ("fma", ctypes.c_double, float)):
    _function = getattr(_C, _name)
    _function.restype, _function.argtypes = _kind, (_kind,) * 3
    _FMA["f32" if _kind is ctypes.c_float else "f64"] = _function

_KINDS = {"f32": (np.float32, np.uint32), "f64": (np.float64, np.uint64)}
_DIGITS = {"f32": 24, "f64": 53}


#: Rounding of floats to integers.
_FRACTIONS = {"rmi": np.floor, "rpi": np.ceil, "rzi": np.trunc, "rni": np.rint}


def is_float(kind: str) -> bool:
    """Whether numbers of a type are floats."""
    return kind[0] == "f"


def width_of(kind: str) -> int:
    """Width of a type in bits."""
    return 1 if kind == "pred" else int(kind[1:])


def signed(value: int, width: int) -> int:
    """An integer with its sign."""
    return value - (1 << width) if value >> (width - 1) else value


def from_bits(value: int, kind: str):
    """The float with these bits."""
    made, whole = _KINDS[kind]
    return whole(value).view(made)


def as_bits(value, kind: str) -> int:
    """The bits of a float."""
    made, whole = _KINDS[kind]
    return int(made(value).view(whole))


def constant(text: str, kind: str):
    """A literal in an instruction."""
    if text[:2] in ("0f", "0d"):
        return from_bits(int(text[2:], 16), "f32" if text[1] == "f" else "f64")
    if kind == "pred":
        return bool(int(text))
    return int(text, 0) & ((1 << width_of(kind)) - 1)


def fused(kind: str):
    """A product and a sum, rounded once."""
    function, made = _FMA[kind], _KINDS[kind][0]
    return lambda a, b, c: made(function(a, b, c))


def smaller(a, b):
    """PTX's min: the other one where one is NaN; -0 is below 0."""
    if math.isnan(a) or math.isnan(b):
        return b if math.isnan(a) else a
    if a == b:
        return a if np.signbit(a) else b
    return min(a, b)


def larger(a, b):
    """PTX's max; see `smaller`."""
    if math.isnan(a) or math.isnan(b):
        return b if math.isnan(a) else a
    if a == b:
        return b if np.signbit(a) else a
    return max(a, b)


def rounded(value: int, kind: str):
    """An integer as a float, rounded once, ties to even."""
    size = abs(value)
    shift = max(size.bit_length() - _DIGITS[kind], 0)
    whole, rest = size >> shift, size & ((1 << shift) - 1)
    half = 1 << (shift - 1) if shift else 1
    if shift and (rest > half or (rest == half and whole & 1)):
        whole += 1
    return _KINDS[kind][0](math.copysign(float(whole << shift), value))


def converted(to: str, source: str, rounding: str):
    """The function of a cvt instruction."""
    if is_float(to) and is_float(source):
        made = _KINDS[to][0]
        if rounding in _FRACTIONS:
            whole_of = _FRACTIONS[rounding]
            return lambda a: made(whole_of(a))
        assert rounding in ("", "rn"), rounding
        return made
    if is_float(to):
        assert rounding == "rn", rounding
        if source[0] == "s":
            return lambda a: rounded(signed(a & _mask(source), width_of(source)), to)
        return lambda a: rounded(a & _mask(source), to)
    if is_float(source):
        low = -(1 << (width_of(to) - 1)) if to[0] == "s" else 0
        high = low + _mask(to)
        way = _FRACTIONS[rounding]

        def whole(a):
            if math.isnan(a):
                return 0
            if math.isinf(a):
                return (high if a > 0 else low) & _mask(to)
            return min(max(int(way(a)), low), high) & _mask(to)

        return whole
    if source[0] == "s" and width_of(to) > width_of(source):
        return lambda a: signed(a & _mask(source), width_of(source)) & _mask(to)
    least = min(_mask(source), _mask(to))
    return lambda a: a & least


def _mask(kind: str) -> int:
    return (1 << width_of(kind)) - 1


def _unordered(compare):
    return lambda a, b: bool(math.isnan(a) or math.isnan(b) or compare(a, b))


def _ordered(compare):
    return lambda a, b: bool(not (math.isnan(a) or math.isnan(b)) and compare(a, b))


_PLAIN = {name: getattr(operator, name) for name in ("eq", "ne", "lt", "le", "gt", "ge")}

#: Comparisons of floats by name; those of integers are the first six.
COMPARISONS = {
    **{name: _ordered(one) for name, one in _PLAIN.items()},
    **{f"{name}u": _unordered(one) for name, one in _PLAIN.items()},
    "num": _ordered(lambda _a, _b: True),
    "nan": _unordered(lambda _a, _b: False),
    **{f"whole {name}": one for name, one in _PLAIN.items()},
}
