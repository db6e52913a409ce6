"""Exact sums of products: expansions, lists of float64 numbers whose sum is the value.

An expansion is in memory, at an address, as a number of components by increasing magnitude that
do not overlap; zeros are left out, so its sign is that of the last one, and none are 0.

Exact while no product underflows or overflows: see `geometry.float64.ray` for the numbers that are
allowed.

References
----------
Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates",
Discrete & Computational Geometry 18(3), 1997.
"""

from __future__ import annotations

import numpy as np

from raystream.geometry.float64.double_numbers import negate_double, two_product, two_sum
from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import bits_as_float, float_as_bits, load, scratch, store

_SHIFT = np.uint64(3)  # a number's eight bytes
_BIT = np.int64(1)

#: Components of a determinant of three vectors of sums of two, at most: six products of eight
#: triples, four components each.
_MOST = 6 * 8 * 4
_MOST_BYTES = 8 * _MOST

#: Of what `_side` sums: a determinant, and another times two numbers.
_SIDE_BYTES = 5 * _MOST_BYTES

#: Ratios outside of this are not rounded exactly: products would underflow or overflow.
_LEAST, _LARGEST = 2.0**-250, 2.0**400

#: Steps from an approximate ratio to the rounded one: at most two, and one that finds none.
_STEPS = 8


@device_call
def _grow(at, count, x):
    """Add a number to an expansion; returns the number of its components."""
    no_inline()
    total, kept = x, ZERO_U64
    for k in range(count):
        total, rest = two_sum(total, load(np.float64, at + (k << _SHIFT)))
        if rest != 0.0:
            store(at + (kept << _SHIFT), rest)
            kept += ONE_U64
    if total != 0.0:
        store(at + (kept << _SHIFT), total)
        kept += ONE_U64
    return kept


@device
def _grow_by_product(at, count, x, y):
    """Add a product of two numbers, exactly."""
    high, low = two_product(x, y)
    return _grow(at, _grow(at, count, low), high)


@device_call
def _add_product(at, count, x, y, z):
    """Add a product of three numbers to an expansion."""
    no_inline()
    if x == 0.0 or y == 0.0 or z == 0.0:
        return count
    product, rest = two_product(x, y)
    if rest != 0.0:
        count = _grow_by_product(at, count, rest, z)
    return _grow_by_product(at, count, product, z)


@device_call
def _add_term(at, count, x, y, z):
    """Add a product of three sums of two numbers."""
    no_inline()
    for i in range(2):
        for j in range(2):
            for k in range(2):
                count = _add_product(at, count, x[i], y[j], z[k])
    return count


@device_call
def determinant(at, x, y, z):
    """Compute the determinant of three vectors exactly.

    Parameters
    ----------
    at : uint64
        Address of memory for the expansion, `_MOST_BYTES`.
    x, y, z : triple of (high, low)
        Each component is the sum of two float64 numbers.

    Returns
    -------
    uint64
        Number of components.
    """
    no_inline()
    count = _add_term(at, ZERO_U64, x[0], y[1], z[2])
    count = _add_term(at, count, x[1], y[2], z[0])
    count = _add_term(at, count, x[2], y[0], z[1])
    count = _add_term(at, count, negate_double(x[0]), y[2], z[1])
    count = _add_term(at, count, negate_double(x[1]), y[0], z[2])
    return _add_term(at, count, negate_double(x[2]), y[1], z[0])


@device
def _value(at, count):
    """An expansion rounded to float64, with at most two roundings; the sign is exact."""
    total = 0.0
    for k in range(count):
        total += load(np.float64, at + (k << _SHIFT))
    return total


@device
def _sign(at, count):
    """A number with the sign of an expansion."""
    if count == ZERO_U64:
        return 0.0
    return load(np.float64, at + ((count - ONE_U64) << _SHIFT))


@device_call
def determinant_value(x, y, z):
    """The determinant of three vectors, rounded from the exact value; see `determinant`."""
    no_inline()
    at = scratch(_MOST_BYTES)
    return _value(at, determinant(at, x, y, z))


@device_call
def _side(top, top_count, base, base_count, ratio, rest):
    """Compare top / base to ratio + rest: a number with the sign of the difference, exactly."""
    no_inline()
    at, count = scratch(_SIDE_BYTES), top_count
    for k in range(top_count):
        store(at + (k << _SHIFT), load(np.float64, top + (k << _SHIFT)))
    for k in range(base_count):
        part = -load(np.float64, base + (k << _SHIFT))
        count = _grow_by_product(at, count, part, ratio)
        count = _grow_by_product(at, count, part, rest)
    sign = _sign(at, count)
    return sign if _sign(base, base_count) > 0.0 else -sign


@device
def _is_nearer(other, ratio, is_odd, top, top_count, base, base_count):
    """Whether top / base is nearer to a neighbour of `ratio`; or in the middle, if that is odd."""
    side = _side(top, top_count, base, base_count, ratio, 0.5 * (other - ratio))
    if other < ratio:
        side = -side
    return side > 0.0 or (side == 0.0 and is_odd)


@device_call
def rounded_ratio(a, p, q, d):
    """The determinant of (a, p, q) divided by that of (d, p, q), rounded to nearest, ties to even.

    Parameters
    ----------
    a, p, q, d : triple of (high, low)
        See `determinant`. The divisor must not be 0.

    Returns
    -------
    float64
        Correctly rounded if its magnitude is in 2**-250 to 2**400.
    """
    no_inline()
    top, base = scratch(_MOST_BYTES), scratch(_MOST_BYTES)
    top_count = determinant(top, a, p, q)
    if top_count == ZERO_U64:
        return 0.0
    base_count = determinant(base, d, p, q)
    ratio = _value(top, top_count) / _value(base, base_count)
    if not (abs(ratio) >= _LEAST and abs(ratio) <= _LARGEST):
        return ratio
    for _ in range(_STEPS):
        bits = float_as_bits(ratio)
        is_odd = bits & _BIT != np.int64(0)
        # Away from 0, then toward it.
        outer, inner = bits_as_float(bits + _BIT), bits_as_float(bits - _BIT)
        if _is_nearer(outer, ratio, is_odd, top, top_count, base, base_count):
            ratio = outer
        elif _is_nearer(inner, ratio, is_odd, top, top_count, base, base_count):
            ratio = inner
        else:
            break
    return ratio
