"""Exact determinants, and ratios of them rounded once, against Python's fractions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from raystream.geometry.float64.double_numbers import add_double, divide_double, multiply_double
from raystream.geometry.float64.expansions import determinant_value, rounded_ratio
from raystream.jit.cpu import compiled

NUMBERS = st.one_of(
    st.integers(-4, 4).map(float),
    st.floats(-1e6, 1e6, allow_subnormal=False).filter(lambda x: x == 0.0 or abs(x) > 1e-30),
    st.floats(2.0**-150, 2.0**150),
)


@st.composite
def vectors(draw):
    """Three components, each the rounded sum of two numbers and its error."""
    parts = []
    for _ in range(3):
        x, y = draw(NUMBERS), draw(NUMBERS)
        high = x - y
        low = float(Fraction(x) - Fraction(y) - Fraction(high))
        parts.append((high, low))
    return tuple(parts)


def exact(vector):
    return [Fraction(high) + Fraction(low) for high, low in vector]


def determinant(x, y, z):
    x, y, z = exact(x), exact(y), exact(z)
    return (
        x[0] * (y[1] * z[2] - y[2] * z[1])
        + x[1] * (y[2] * z[0] - y[0] * z[2])
        + x[2] * (y[0] * z[1] - y[1] * z[0])
    )


@compiled
def value_of(x, y, z):
    return determinant_value(x, y, z)


@compiled
def ratio_of(a, p, q, d):
    return rounded_ratio(a, p, q, d)


@compiled
def arithmetic(x, y):
    return add_double(x, y), multiply_double(x, y), divide_double(x, y)


@given(vectors(), vectors(), vectors())
def test_determinants_have_exact_signs(x, y, z):
    value, wanted = value_of(x, y, z), determinant(x, y, z)
    assert np.sign(value) == (wanted > 0) - (wanted < 0)
    assert abs(Fraction(value) - wanted) <= abs(wanted) * Fraction(2) ** -51


@given(vectors(), vectors(), st.sampled_from([-2.0, -0.25, 0.0, 1.0, 4.0]))
def test_a_determinant_of_dependent_vectors_is_zero(x, y, factor):
    z = tuple((factor * high, factor * low) for high, low in x)
    assert value_of(x, y, z) == value_of(x, z, y) == value_of(y, z, x) == 0.0


@given(vectors(), vectors(), vectors(), vectors())
def test_ratios_are_rounded_once(a, p, q, d):
    base = determinant(d, p, q)
    if base == 0:
        return
    wanted = determinant(a, p, q) / base
    if wanted == 0 or 2.0**-250 <= abs(wanted) <= 2.0**400:
        assert ratio_of(a, p, q, d) == wanted.numerator / wanted.denominator


@given(st.integers(1, 2**53 - 1), st.integers(-60, 60), st.booleans())
def test_ties_are_rounded_to_even(mantissa, exponent, is_negative):
    """Ratios halfway between two numbers: (2 mantissa + 1) / 2 with 53 bits in the mantissa."""
    mantissa |= 2**52
    high, low = float(mantissa), 0.5
    scale = (-1.0 if is_negative else 1.0) * 2.0**exponent
    zero, one = (0.0, 0.0), (1.0, 0.0)
    a = ((scale * high, scale * low), zero, zero)
    unit_y, unit_z, unit_x = (zero, one, zero), (zero, zero, one), (one, zero, zero)
    wanted = Fraction(2 * mantissa + 1, 2) * Fraction(scale)
    assert ratio_of(a, unit_y, unit_z, unit_x) == wanted.numerator / wanted.denominator


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_double_numbers_are_as_exact_as_stated(a, b, c, d):
    x = (a + b * 2.0**-60, 0.0) if a == 0.0 else (a, a * 2.0**-54)
    y = (c, 0.0) if c == 0.0 else (c, d * 2.0**-54 if abs(d) < abs(c) else 0.0)
    total, product, quotient = arithmetic(x, y)
    exact_x, exact_y = sum(map(Fraction, x)), sum(map(Fraction, y))
    error = abs(sum(map(Fraction, total)) - exact_x - exact_y)
    assert error <= (abs(exact_x) + abs(exact_y)) * Fraction(2) ** -104
    error = abs(sum(map(Fraction, product)) - exact_x * exact_y)
    assert error <= abs(exact_x * exact_y) * 7 * Fraction(2) ** -106
    if exact_y:
        error = abs(sum(map(Fraction, quotient)) - exact_x / exact_y)
        assert error <= abs(exact_x / exact_y) * Fraction(2) ** -100
