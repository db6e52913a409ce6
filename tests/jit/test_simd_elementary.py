"""Sines, exponentials, logarithms and powers in kernels, against NumPy in double precision."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.jit.cpu import kernel
from raystream.jit.simd import (
    address,
    exponential,
    f32x16,
    load,
    logarithm,
    next_float_up,
    power,
    sincos_turns,
    store,
)


@kernel
def of_vectors(x, exponents, out):
    """Rows of `out`: cosine, sine, exponential, logarithm, power."""
    row = np.uint64(4 * len(x))
    for i in range(len(x) // 16):
        place = np.uint64(64 * i)
        a, b = load(f32x16, address(x) + place), load(f32x16, address(exponents) + place)
        at = address(out) + place
        cosine, sine = sincos_turns(a)
        store(at, cosine)
        store(at + row, sine)
        store(at + row + row, exponential(a))
        store(at + row + row + row, logarithm(a))
        store(at + row + row + row + row, power(a, b))


@kernel
def of_numbers(x, exponents, out):
    for i in range(len(x)):
        out[0, i], out[1, i] = sincos_turns(x[i])
        out[2, i] = exponential(x[i])
        out[3, i] = logarithm(x[i])
        out[4, i] = power(x[i], exponents[i])


def of(x, exponents=None, run=of_vectors):
    x = np.asarray(x)
    exponents = np.ones_like(x) if exponents is None else np.asarray(exponents, x.dtype)
    out = np.empty((5, len(x)), x.dtype)
    run(x, exponents, out)
    return out


def float32s(low, high):
    """Floats between two, 65,536 at even distances in value and as many in bits."""
    bits = np.linspace(*np.array([low, high], np.float32).view(np.int32), 1 << 16)
    return np.concatenate(
        [np.linspace(low, high, 1 << 16, dtype=np.float32), bits.astype(np.int32).view(np.float32)]
    )


def units(result, exact):
    """Errors in units of the last place."""
    return np.abs(result - exact) / np.spacing(np.abs(exact).astype(np.float32))


def test_turned():
    parts = np.concatenate([float32s(1e-6, 1.0), -float32s(1e-6, 3.0), float32s(1.0, 1e6)])
    cosine, sine = of(parts)[:2]
    angle = 2.0 * np.pi * (parts.astype(np.float64) % 1.0)
    assert np.abs(cosine - np.cos(angle)).max() < 1.2e-7
    assert np.abs(sine - np.sin(angle)).max() < 1.2e-7
    for quarter, (x, y) in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)]):
        exact = of(np.full(16, quarter / 4, np.float32))[:2, 0]
        np.testing.assert_array_equal(exact, [x, y])


def test_exponential():
    x = np.concatenate([float32s(1e-6, 88.0), -float32s(1e-6, 87.0)])
    assert units(of(x)[2], np.exp(x.astype(np.float64))).max() < 2.0
    ends = of(np.repeat(np.float32([-1e30, 1e30, 0.0, -0.0]), 4))[2, ::4]
    np.testing.assert_array_equal(ends[2:], 1.0)
    np.testing.assert_allclose(ends[:2], np.exp([-87.0, 88.0]), rtol=1e-6)


def test_logarithm():
    x = np.concatenate([float32s(1.2e-38, 1.0), float32s(1.0, 3e38), float32s(0.7, 1.5)])
    result, exact = of(x)[3], np.log(x.astype(np.float64))
    assert units(result, exact)[np.abs(exact) > 1e-30].max() < 2.0
    np.testing.assert_array_equal(of(np.ones(16, np.float32))[3], 0.0)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 7.0, 300.0])
def test_power(exponent):
    x = float32s(1e-6, 1.0)
    result = of(x, np.full_like(x, exponent))[4]
    exact = x.astype(np.float64) ** exponent
    far = np.abs(exponent * np.log(x.astype(np.float64)))
    seen = exact > 1e-30
    wrong = np.abs(result[seen] / exact[seen] - 1.0)
    assert (wrong - 1.2e-7 * far[seen]).max() < 4e-7


def test_power_of_nothing():
    x = np.float32([0.0, -0.0, -1.0, -np.inf] * 4)
    np.testing.assert_array_equal(of(x, np.full_like(x, 2.0))[4], 0.0)
    np.testing.assert_array_equal(of(x[:4].astype(np.float64), run=of_numbers)[4], 0.0)


def test_numbers():
    """float32 numbers get the vectors' bits, float64 ones the library's."""
    x = float32s(1e-3, 80.0)[::64].copy()
    exponents = np.linspace(0.5, 2.0, len(x), dtype=np.float32)
    np.testing.assert_array_equal(of(x, exponents, of_numbers), of(x, exponents))
    x, exponents = x.astype(np.float64), exponents.astype(np.float64)
    cosine, sine, *rest = of(x, exponents, of_numbers)
    np.testing.assert_allclose(cosine, np.cos(2.0 * np.pi * x), atol=1e-13)
    np.testing.assert_allclose(sine, np.sin(2.0 * np.pi * x), atol=1e-13)
    np.testing.assert_allclose(rest, [np.exp(x), np.log(x), x**exponents], rtol=1e-14, atol=1e-15)


LARGEST = np.finfo(np.float32).max
LEAST = np.float32(2.0**-149)


@kernel
def _next_above(values, out):
    for i in range(len(values)):
        out[i] = next_float_up(values[i])


def test_the_next_float_is_numpys(rng):
    special = [0.0, -0.0, 1.0, -1.0, LEAST, -LEAST, LARGEST, -LARGEST, np.inf, -np.inf, np.nan]
    bits = rng.integers(0, 2**32, 1000, dtype=np.uint32)
    values = np.concatenate([np.array(special, np.float32), bits.view(np.float32)])
    out = np.empty_like(values)
    _next_above(values, out)
    with np.errstate(all="ignore"):
        expected = np.nextafter(values, np.float32(np.inf))
    known = ~np.isnan(values)
    assert out[known].tobytes() == expected[known].tobytes()
    assert np.isnan(out[~known]).all()
