"""float64 in the integers of shaders: every bit is that of the CPU's."""

from __future__ import annotations

import numpy as np
import pytest

from graphics.shader_values import values_of
from raystream.graphics.shader_source import shader_source

COUNT = 1 << 14

#: Below, numbers count as 0.
SMALLEST = np.finfo(np.float64).tiny


@pytest.fixture
def evaluate(opened):
    """Words of an expression of float64.wgsl for rows of two doubles, x.xy and x.zw."""

    def values(expression: str, a, b) -> np.ndarray:
        doubles = np.column_stack([a, b]).astype(np.float64)
        return values_of(opened, shader_source("float64.wgsl"), expression, doubles.view(np.uint32))

    return values


@pytest.fixture
def pairs(rng) -> tuple[np.ndarray, np.ndarray]:
    """Doubles near and far from each other; many with few bits, whose results are ties."""
    bits = rng.integers(0, 1 << 52, (2, COUNT), np.uint64)
    few = rng.integers(0, 1 << 52, (3, 2, COUNT), np.uint64)
    bits[:, ::2] = (few[0] & few[1] & few[2])[:, ::2]
    bits[:, 1::4] &= np.uint64(0xFFFFFFC000000)  # products have 54 bits at most
    bits[0, 3::8] = bits[1, 3::8] ^ rng.integers(0, 8, COUNT, np.uint64)[3::8]  # they cancel
    exponents = rng.integers(1023 - 70, 1023 + 70, (2, COUNT))
    near = rng.integers(-60, 61, COUNT)
    exponents[1] = np.where(rng.random(COUNT) < 0.7, exponents[0] + near, exponents[1])
    exponents[1, 3::8] = exponents[0, 3::8]
    exponents[:, :500] = rng.integers(1, 2047, (2, 500))
    signs = rng.integers(0, 2, (2, COUNT), np.uint64) << np.uint64(63)
    a, b = (signs | (exponents.astype(np.uint64) << np.uint64(52)) | bits).view(np.float64)
    special = [0.0, -0.0, 1.0, -1.0, SMALLEST, 2.0**1023, 1.0 + 2.0**-52, 2.0 - 2.0**-52]
    first, second = np.meshgrid(special, special)
    a[-64:], b[-64:] = first.ravel(), second.ravel()
    return a, b


def as_doubles(words: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(words).view(np.float64)[:, 0]


def without_small(x: np.ndarray) -> np.ndarray:
    return np.where(np.abs(x) < SMALLEST, np.copysign(0.0, x), x)


def assert_same_words(found: np.ndarray, expected: np.ndarray) -> None:
    np.testing.assert_array_equal(found.view(np.uint64), expected.view(np.uint64))


@pytest.mark.parametrize(
    ("expression", "exact"),
    [
        ("double_sum(x.xy, x.zw)", np.add),
        ("double_difference(x.xy, x.zw)", np.subtract),
        ("double_product(x.xy, x.zw)", np.multiply),
        ("double_quotient(x.xy, x.zw)", np.divide),
        ("smaller(x.xy, x.zw)", np.minimum),
        ("larger(x.xy, x.zw)", np.maximum),
    ],
)
def test_results_are_those_of_the_cpu(evaluate, pairs, expression, exact) -> None:
    a, b = pairs
    if exact is np.divide:
        a, b = a[b != 0.0], b[b != 0.0]
    with np.errstate(all="ignore"):
        expected = without_small(exact(a, b))
        # At the bound of what counts as 0 the CPU may round up to it.
        is_sure = (np.abs(expected) > SMALLEST) | (expected == 0.0)
    found = as_doubles(evaluate(expression, a, b))
    if exact in (np.minimum, np.maximum):  # of two zeros either
        found, expected = found + 0.0, expected + 0.0
    assert_same_words(found[is_sure], expected[is_sure])
    assert np.count_nonzero(is_sure) > 0.99 * len(a)


def test_comparisons_are_those_of_the_cpu(evaluate, pairs) -> None:
    a, b = pairs
    b = np.where(np.arange(COUNT) % 5 == 0, a, b)
    found = evaluate("vec2u(u32(is_less(x.xy, x.zw)), u32(is_less(x.zw, x.xy)))", a, b)
    np.testing.assert_array_equal(found, np.column_stack([a < b, b < a]))


def test_powers_of_two_are_exact(evaluate, pairs) -> None:
    a, _ = pairs
    powers = np.random.default_rng(1).integers(-1100, 1100, COUNT)
    found = as_doubles(evaluate("scaled(x.xy, bitcast<i32>(x.z))", a, powers.view(np.float64)))
    with np.errstate(all="ignore"):
        expected = without_small(np.ldexp(a, powers))
    is_sure = np.abs(expected) != SMALLEST
    assert_same_words(found[is_sure], expected[is_sure])


def test_floats_are_rounded_once(evaluate, rng) -> None:
    """Also to denormal ones; those that are too large become the largest."""
    x = rng.normal(size=COUNT) * 2.0 ** rng.integers(-160, 140, COUNT)
    with np.errstate(all="ignore"):
        floats = x[::2].astype(np.float32).astype(np.float64)
        beside = np.nextafter(x[::2].astype(np.float32), np.float32(0)).astype(np.float64)
    x[::2] = np.where(np.isfinite(floats), (floats + beside) / 2, x[::2])  # ties
    x[:4] = [0.0, -0.0, 3.4028235677973366e38, -1e300]
    found = evaluate("vec2u(bitcast<u32>(narrowed(x.xy)), 0u)", x, x)[:, 0].view(np.float32)
    most = np.finfo(np.float32).max
    with np.errstate(over="ignore"):
        expected = np.clip(x.astype(np.float32), -most, most)
    np.testing.assert_array_equal(found.view(np.uint32), expected.view(np.uint32))
    assert np.count_nonzero(np.abs(expected) < np.finfo(np.float32).tiny) > 500


def test_floats_are_widened(evaluate, rng) -> None:
    words = rng.integers(0, 1 << 32, COUNT, np.uint64).astype(np.uint32)
    words[::3] &= np.uint32(0x807FFFFF)  # denormal
    words[:2] = 0, 0x80000000
    floats = words.view(np.float32)
    floats = floats[np.isfinite(floats)]
    with_words = np.zeros(len(floats), np.float64)
    with_words.view(np.float32)[::2] = floats
    found = as_doubles(evaluate("widened(bitcast<f32>(x.x))", with_words, with_words))
    assert_same_words(found, floats.astype(np.float64))
