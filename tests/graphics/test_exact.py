"""Arithmetic of shaders: exact where documented, and close to float64 where the CPU uses it."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from graphics.shader_values import values_of
from raystream.graphics.shader_source import shader_source

_AS_PAIR = "fn as_pair(x: Wide) -> vec2f { return vec2f(x.high, x.low); }"


@pytest.fixture
def evaluate(opened):
    """Values of an expression of exact.wgsl for rows (x.x, x.y, x.z, x.w)."""
    source = shader_source("exact.wgsl") + _AS_PAIR

    def values(expression: str, rows: np.ndarray) -> np.ndarray:
        return values_of(opened, source, expression, rows.astype(np.float32)).astype(np.float64)

    return values


@pytest.fixture
def rows(rng) -> np.ndarray:
    """Of all sizes and signs, and pairs that nearly cancel."""
    count = 4096
    sizes = 2.0 ** rng.integers(-20, 21, (count, 4))
    rows = (rng.uniform(-2.0, 2.0, (count, 4)) * sizes).astype(np.float32)
    rows[::4, 1] = -np.nextafter(rows[::4, 0], np.float32(0))
    rows[1::4, 2:] = rows[1::4, :2] * rng.choice([1, -1, 1 + 2.0**-20], (count // 4, 2))
    return rows.astype(np.float32)


def test_products_are_exact(evaluate, rows):
    high, low = evaluate("as_pair(exact_product(x.x, x.y))", rows).T
    x, y = rows[:, :2].astype(np.float64).T
    assert np.array_equal(high, (rows[:, 0] * rows[:, 1]).astype(np.float64))
    assert np.array_equal(high + low, x * y)  # 48 bits


def test_sums_are_exact(evaluate, rows):
    high, low = evaluate("as_pair(exact_sum(x.x, x.y))", rows).T
    assert np.array_equal(high, (rows[:, 0] + rows[:, 1]).astype(np.float64))
    for row, one, other in zip(rows[:500], high[:500], low[:500], strict=True):
        assert Fraction(one) + Fraction(other) == Fraction(float(row[0])) + Fraction(float(row[1]))


def test_determinants_are_right_where_they_cancel(evaluate, rows):
    high, low = evaluate("as_pair(wide_determinant(x.x, x.y, x.z, x.w))", rows).T
    for row, one, other in zip(rows[:2000], high[:2000], low[:2000], strict=True):
        a, b, c, d = (Fraction(float(number)) for number in row)
        exact = a * b - c * d
        found = Fraction(one) + Fraction(other)
        assert (found > 0, found < 0) == (exact > 0, exact < 0)
        assert abs(found - exact) <= abs(exact) * Fraction(2) ** -40


@pytest.mark.parametrize(
    ("expression", "device_scheduler"),
    [
        ("wide_sum(exact_product(x.x, x.y), Wide(x.z, 0.0))", lambda x, y, z, _: x * y + z),
        (
            "wide_product(exact_product(x.x, x.y), exact_sum(x.z, x.w))",
            lambda x, y, z, w: x * y * (z + w),
        ),
    ],
)
def test_wide_numbers_have_more_than_40_bits(evaluate, rows, expression, device_scheduler):
    high, low = evaluate(f"as_pair({expression})", rows).T
    for row, one, other in zip(rows[:2000], high[:2000], low[:2000], strict=True):
        numbers = [Fraction(float(number)) for number in row]
        exact = device_scheduler(*numbers)
        size = abs(numbers[0] * numbers[1]) + abs(numbers[2])
        if "sum(exact_product" in expression:
            allowed = size * Fraction(2) ** -44
        else:
            allowed = abs(exact) * Fraction(2) ** -42
        assert abs(Fraction(one) + Fraction(other) - exact) <= allowed


def test_quotients_are_rounded_once(evaluate, rows):
    kept = rows[(np.abs(rows[:, 1]) > 0)]
    found = evaluate("vec2f(quotient(x.x, x.y), 0.0)", kept)[:, 0]
    exact = kept[:, 0].astype(np.float64) / kept[:, 1].astype(np.float64)
    assert np.array_equal(found, exact.astype(np.float32).astype(np.float64))


def test_wide_quotients_are_rounded_once(evaluate, rows):
    kept = rows[(np.abs(rows[:, 2:]).min(axis=1) > 0)]
    expression = "vec2f(wide_quotient(exact_product(x.x, x.y), exact_product(x.z, x.w)), 0.0)"
    found = evaluate(expression, kept)[:, 0]
    x, y, z, w = kept.astype(np.float64).T
    assert np.array_equal(found, (x * y / (z * w)).astype(np.float32).astype(np.float64))


def test_fused_sums_are_rounded_once(evaluate, rows):
    found = evaluate("vec2f(fused(x.x, x.y, x.z), 0.0)", rows)[:, 0]
    for row, one in zip(rows[:2000], found[:2000], strict=True):
        a, b, c, _ = (Fraction(float(number)) for number in row)
        exact = a * b + c
        # Nearer than any neighbour, or a tie that float64 cannot see.
        step = Fraction(float(np.spacing(np.float32(abs(one)))))
        assert abs(Fraction(one) - exact) <= step / 2 * (1 + Fraction(2) ** -20)
