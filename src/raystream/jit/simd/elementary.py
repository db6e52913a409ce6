"""Sines, exponentials, logarithms and powers of float32 vectors and numbers, and the next float.

They are float32 polynomials, with the same bits in each lane and on every processor. Their errors,
in the docstrings, are measured by ``tests/jit/test_simd_elementary.py``. float64 numbers use the C
library's functions.

References
----------
Moshier, "Methods and Programs for Mathematical Functions", 1989 (Cephes): the coefficients.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from raystream.jit.cpu import FLAGS, device
from raystream.jit.simd.arithmetic import floor, maximum, minimum, one_lane
from raystream.jit.simd.convert import as_float32, as_int32
from raystream.jit.simd.lanes import bits_as_float, float_as_bits, select
from raystream.jit.simd.types import VectorType

_0, _HALF, _1, _2, _3 = map(np.float32, (0.0, 0.5, 1.0, 2.0, 3.0))
_QUARTER, _4, _TWO_PI = np.float32(0.25), np.float32(4.0), np.float32(2.0 * math.pi)
_TINY = np.float32(1e-37)
_SMALLEST, _INF = np.float32(2.0**-149), np.float32(math.inf)

_SIN = tuple(map(np.float32, (-1.6666654611e-1, 8.3321608736e-3, -1.9515295891e-4)))
_COS = tuple(map(np.float32, (4.166664568298827e-2, -1.388731625493765e-3, 2.443315711809948e-5)))

# log(2) in two parts: products of integers and the first part are exact.
_LOG_2, _LOG_2_REST = np.float32(0.693359375), np.float32(-2.12194440e-4)
_LOG2_E, _SQRT_HALF = np.float32(1.0 / math.log(2.0)), np.float32(math.sqrt(0.5))
_LEAST, _MOST = np.float32(-87.0), np.float32(88.0)
_EXP = (
    *map(np.float32, (1.9875691500e-4, 1.3981999507e-3, 8.3334519073e-3)),
    *map(np.float32, (4.1665795894e-2, 1.6666665459e-1, 5.0000001201e-1)),
)
_LOG = (
    *map(np.float32, (7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1)),
    *map(np.float32, (-1.2420140846e-1, 1.4249322787e-1, -1.6668057665e-1)),
    *map(np.float32, (2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1)),
)

_BIAS, _BIAS_OF_HALF, _EXPONENT = np.int32(127), np.int32(126), np.int32(0xFF)
_MANTISSA_BITS, _MANTISSA, _HALF_BITS = np.int32(23), np.int32(0x007FFFFF), np.int32(0x3F000000)


def sincos_turns(part: Any) -> Any:
    """Cosine and sine of an angle whose unit is a full turn.

    For float32 to within 1.2e-7, from -1e6 to 1e6 turns.
    """
    raise NotImplementedError("kernels only")


def exponential(x: Any) -> Any:
    """The exponential function: for float32 to within 2 units in the last place.

    Arguments are clamped to -87 to 88.
    """
    raise NotImplementedError("kernels only")


def logarithm(x: Any) -> Any:
    """The natural logarithm: for normal float32 above 0 to within 2 units in the last place."""
    raise NotImplementedError("kernels only")


def power(x: Any, exponent: Any) -> Any:
    """X to the power of an exponent; 0 where x is not above 1e-37.

    For float32 with a relative error of 1.2e-7 times the exponent times log(x), or 4e-7 if that
    is more.
    """
    raise NotImplementedError("kernels only")


@device
def _parts(x):
    """Mantissa in [0.5, 1) and exponent of a float32, both float32."""
    bits = float_as_bits(x)
    exponent = as_int32(((bits >> _MANTISSA_BITS) & _EXPONENT) - _BIAS_OF_HALF)
    return bits_as_float(as_int32((bits & _MANTISSA) | _HALF_BITS)), as_float32(exponent)


@device
def _power_of_2(whole):
    """2 to the power of an integer in float32, within the range of float32's exponents."""
    return bits_as_float(as_int32((as_int32(whole) + _BIAS) << _MANTISSA_BITS))


@device
def _turned(part):
    quadrant = floor(part * _4 + _HALF)
    angle = (part - quadrant * _QUARTER) * _TWO_PI
    square = angle * angle
    sine = angle + angle * square * (_SIN[0] + square * (_SIN[1] + square * _SIN[2]))
    cosine = (_1 - _HALF * square) + square * square * (
        _COS[0] + square * (_COS[1] + square * _COS[2])
    )
    # The quadrant modulo 4; quadrants swap and negate the first one's cosine and sine.
    quadrant = quadrant - _4 * floor(quadrant * _QUARTER)
    is_odd = (quadrant == _1) | (quadrant == _3)
    x, y = select(is_odd, sine, cosine), select(is_odd, cosine, sine)
    x = select((quadrant == _1) | (quadrant == _2), -x, x)
    return x, select(quadrant >= _2, -y, y)


@device
def _turned_float64(part):
    angle = 2.0 * math.pi * part
    return math.cos(angle), math.sin(angle)


@device
def _exponential(x):
    x = minimum(maximum(x, _LEAST), _MOST)
    whole = floor(x * _LOG2_E + _HALF)
    x = (x - whole * _LOG_2) - whole * _LOG_2_REST
    y = ((((_EXP[0] * x + _EXP[1]) * x + _EXP[2]) * x + _EXP[3]) * x + _EXP[4]) * x + _EXP[5]
    return (y * x * x + x + _1) * _power_of_2(whole)


@device
def _logarithm(x):
    mantissa, exponent = _parts(x)
    is_low = mantissa < _SQRT_HALF
    exponent = select(is_low, exponent - _1, exponent)
    m = select(is_low, mantissa + mantissa, mantissa) - _1
    y = ((_LOG[0] * m + _LOG[1]) * m + _LOG[2]) * m + _LOG[3]
    y = (((y * m + _LOG[4]) * m + _LOG[5]) * m + _LOG[6]) * m + _LOG[7]
    square = m * m
    y = ((y * m + _LOG[8]) * m * square + exponent * _LOG_2_REST) - _HALF * square
    return (m + y) + exponent * _LOG_2


@device
def _power(x, exponent):
    raised = _exponential(exponent * _logarithm(maximum(x, _TINY)))
    return select(x > _TINY, raised, raised * _0)


@device
def _power_float64(x, exponent):
    return x**exponent if x > 1e-37 else 0.0


def _is_float32(*given: Any) -> bool:
    kinds = [type_ if isinstance(type_, VectorType) else one_lane(type_) for type_ in given]
    return all(vector is not None and vector.kind == "f32" for vector in kinds)


_OPTIONS = {**FLAGS, "forceinline": True}


@overload(sincos_turns, jit_options=_OPTIONS, strict=False)
def _sincos_turns_of(part: Any) -> Any:
    if _is_float32(part):
        return lambda part: _turned(part)
    return (lambda part: _turned_float64(part)) if part == types.float64 else None


@overload(exponential, jit_options=_OPTIONS, strict=False)
def _exponential_of(x: Any) -> Any:
    if _is_float32(x):
        return lambda x: _exponential(x)
    return (lambda x: math.exp(x)) if x == types.float64 else None


@overload(logarithm, jit_options=_OPTIONS, strict=False)
def _logarithm_of(x: Any) -> Any:
    if _is_float32(x):
        return lambda x: _logarithm(x)
    return (lambda x: math.log(x)) if x == types.float64 else None


@overload(power, jit_options=_OPTIONS, strict=False)
def _power_of(x: Any, exponent: Any) -> Any:
    if _is_float32(x, exponent):
        return lambda x, exponent: _power(x, exponent)
    both = isinstance(x, types.Float) and isinstance(exponent, types.Float)
    return (lambda x, exponent: _power_float64(x, exponent)) if both else None


@device
def next_float_up(x):
    """The smallest float32 larger than x; infinity for infinity, and NaN for NaN."""
    if not x < _INF:
        return x
    if x == _0:
        return _SMALLEST
    step = np.int32(1) if x > _0 else np.int32(-1)
    return bits_as_float(np.int32(float_as_bits(x) + step))
