"""Arithmetic on vectors, lane by lane, against NumPy."""

from __future__ import annotations

import re
from fractions import Fraction
from functools import cache

import numba
import numpy as np
import pytest

from jit.vector_types import DTYPES, FLOAT_TYPES, INTEGER_TYPES
from raystream.jit import simd
from raystream.jit.cpu import device
from raystream.jit.simd import address, select

# ---- Operations side by side, in a kernel and in NumPy.


@device
def at(array, i):
    return address(array) + np.uint64(i * array.itemsize)


@device
def ones(mask, one):
    return select(mask, one, one - one)


def in_place(sign):
    names = {}
    exec(f"def operate(x, y):\n    x {sign}= y\n    return x", names)
    return device(names["operate"])


SIGNS = {
    "add": "+",
    "subtract": "-",
    "multiply": "*",
    "divide": "/",
    "both": "&",
    "either": "|",
    "differ": "^",
    "left": "<<",
    "right": ">>",
}
NAMES = {
    **{name: getattr(simd, name) for name in simd.__all__},
    **{f"{name}_in_place": in_place(sign) for name, sign in SIGNS.items()},
    "np": np,
    "at": at,
    "ones": ones,
}


@cache
def compiled(vector, operations):
    """Compile a kernel that gives one row for each operation on x, y, z and a number s."""
    lines = [
        "def run(a, b, c, s, out):",
        "    one, step = vector(1), np.uint64(out.strides[0])",
        f"    for i in range(0, a.size, {vector.lane_count}):",
        "        x, y, z = load(vector, at(a, i)), load(vector, at(b, i)), load(vector, at(c, i))",
        "        row = at(out[0], i)",
        *(f"        store(row, {code}); row += step" for code in operations),
    ]
    names = {**NAMES, "vector": vector}
    exec("\n".join(lines), names)
    return numba.njit(error_model="numpy")(names["run"])


def assert_rows(vector, operations, x, y, z, s):
    """Compare bits, except those of NaN: which one it is, is not said."""
    out = np.empty((len(operations), x.size), x.dtype)
    kernel = compiled(vector, tuple(operations))
    kernel(x, y, z, s, out)
    integer = np.dtype(f"i{x.itemsize}")
    for row, (code, function) in zip(out, operations.items(), strict=True):
        with np.errstate(all="ignore"):
            wanted = np.asarray(function(x, y, z, s)).astype(x.dtype)
        same = (row.view(integer) == wanted.view(integer)) | (np.isnan(row) & np.isnan(wanted))
        first = int(np.argmin(same))
        given = (x[first], y[first], z[first], s)
        assert same.all(), (code, given, row[first], wanted[first])
    assert_generic(kernel)


def assert_generic(kernel):
    """No instruction of one machine; Numba's own reference counts use an atomic one."""
    for code in kernel.inspect_llvm().values():
        assert not re.findall(r"llvm\.(?:x86\.(?!atomic)|aarch64)[\w.]*", code)


COMPARISONS = {
    f"ones({x} {sign} {y}, one)": eval(f"lambda x, y, z, s: {x} {sign} {y}")
    for x, y, signs in (("x", "y", "< <= > >= == !="), ("x", "s", "< !="), ("s", "x", "> =="))
    for sign in signs.split()
}
ANY_NUMBER = {
    "x + y": lambda x, y, z, s: x + y,
    "x - y": lambda x, y, z, s: x - y,
    "x * y": lambda x, y, z, s: x * y,
    "x + s": lambda x, y, z, s: x + s,
    "s - x": lambda x, y, z, s: s - x,
    "s * x": lambda x, y, z, s: s * x,
    "x * y + z": lambda x, y, z, s: x * y + z,  # never fused
    "-x": lambda x, y, z, s: -x,
    "add_in_place(x, y)": lambda x, y, z, s: x + y,
    "subtract_in_place(x, s)": lambda x, y, z, s: x - s,
    "multiply_in_place(x, y)": lambda x, y, z, s: x * y,
    **COMPARISONS,
    "minimum(x, y)": lambda x, y, z, s: np.where(x < y, x, y),
    "maximum(x, y)": lambda x, y, z, s: np.where(x > y, x, y),
    "minimum(x, s)": lambda x, y, z, s: np.where(x < s, x, s),
    "maximum(s, x)": lambda x, y, z, s: np.where(s > x, s, x),
    "select(x < y, x, z)": lambda x, y, z, s: np.where(x < y, x, z),
    "select(x < y, x, s)": lambda x, y, z, s: np.where(x < y, x, s),
    "select(x < y, s, x)": lambda x, y, z, s: np.where(x < y, s, x),
    "select(s == s, x, y)": lambda x, y, z, s: np.where(s == s, x, y),
    "select(s != s, x, y)": lambda x, y, z, s: np.where(s != s, x, y),
    "vector(s)": lambda x, y, z, s: np.full_like(x, s),
    "vector(x)": lambda x, y, z, s: x,
}
FLOATS = ANY_NUMBER | {
    "x / y": lambda x, y, z, s: x / y,
    "s / x": lambda x, y, z, s: s / x,
    "divide_in_place(x, s)": lambda x, y, z, s: x / s,
    "absolute(x)": lambda x, y, z, s: np.abs(x),
    "copy_sign(x, y)": lambda x, y, z, s: np.copysign(x, y),
    "bits_as_float(float_as_bits(x))": lambda x, y, z, s: x,
    "vector(2.5)": lambda x, y, z, s: np.full_like(x, 2.5),
}
INTEGERS = ANY_NUMBER | {
    "x & y": lambda x, y, z, s: x & y,
    "x | y": lambda x, y, z, s: x | y,
    "x ^ y": lambda x, y, z, s: x ^ y,
    "~x": lambda x, y, z, s: ~x,
    "x & s": lambda x, y, z, s: x & s,
    "s | x": lambda x, y, z, s: x | s,
    "x << z": lambda x, y, z, s: x << z,
    "x >> z": lambda x, y, z, s: x >> z,
    "x >> 3": lambda x, y, z, s: x >> 3,
    "s << z": lambda x, y, z, s: s << z,
    "3 + x": lambda x, y, z, s: x + 3,
    "x * -5": lambda x, y, z, s: x * -5,
    "x ^ 0x80000000": lambda x, y, z, s: x ^ np.array(0x80000000).astype(x.dtype),
    "both_in_place(x, y)": lambda x, y, z, s: x & y,
    "either_in_place(x, s)": lambda x, y, z, s: x | s,
    "differ_in_place(x, 1)": lambda x, y, z, s: x ^ 1,
    "left_in_place(x, z)": lambda x, y, z, s: x << z,
    "right_in_place(x, 2)": lambda x, y, z, s: x >> 2,
    "float_as_bits(bits_as_float(x))": lambda x, y, z, s: x,
    "vector(-7)": lambda x, y, z, s: np.full_like(x, -7),
}


def hard_floats(dtype):
    limits = np.finfo(dtype)
    positive = [0.0, 1.0, 1.5, 1 / 3, limits.max, limits.tiny, limits.smallest_subnormal, np.inf]
    values = np.array([*positive, *(-number for number in positive)], dtype)
    values[-1] = np.nan
    return np.concatenate([values, values * dtype(0.75)])


@pytest.mark.parametrize("vector", FLOAT_TYPES, ids=str)
def test_float_operators(vector, rng):
    with np.errstate(all="ignore"):
        values = hard_floats(DTYPES[vector.kind])
    x, y = (axis.ravel() for axis in np.meshgrid(values, values))
    assert_rows(vector, FLOATS, x, y, rng.permutation(x), x.dtype.type(-2.7))


@pytest.mark.parametrize("number", [0.0, -0.0, np.inf, np.nan, 1e-40])
def test_hard_numbers_as_operands(number):
    with np.errstate(all="ignore"):
        x = hard_floats(np.float32)
    assert_rows(simd.f32x8, FLOATS, x, x[::-1].copy(), x, np.float32(number))


@pytest.mark.parametrize("vector", INTEGER_TYPES, ids=str)
def test_integer_operators_wrap_around(vector, rng):
    dtype = DTYPES[vector.kind]
    limits = np.iinfo(dtype)
    values = np.concatenate(
        [
            [0, 1, -1, 2, 7, -8, limits.max, limits.min, limits.max - 1, limits.min + 1],
            rng.integers(limits.min, limits.max, 22),
        ]
    ).astype(dtype)
    x, y = (axis.ravel() for axis in np.meshgrid(values, values))
    assert_rows(vector, INTEGERS, x, y, rng.integers(0, limits.bits, x.size, dtype), dtype(12345))


# ---- Fused multiply-add.


def rounded(exact, dtype):
    """Round a fraction to the nearest number of a dtype, to even if two are as near."""
    limits = np.finfo(dtype)
    if exact == 0:
        return dtype(0)
    magnitude = abs(exact)
    exponent = magnitude.numerator.bit_length() - magnitude.denominator.bit_length()
    exponent -= magnitude < Fraction(2) ** exponent
    unit = Fraction(2) ** max(exponent - limits.nmant, int(limits.minexp) - limits.nmant)
    return dtype(float(round(exact / unit) * unit))


@pytest.mark.parametrize("vector", FLOAT_TYPES, ids=str)
def test_fma_rounds_once(vector, rng):
    dtype = DTYPES[vector.kind]
    eps = np.finfo(dtype).eps
    x = (1 + rng.integers(-50, 50, 256) * eps).astype(dtype)
    y = (1 + rng.integers(-50, 50, 256) * eps).astype(dtype)
    z = -(x * y)
    z[::2] *= rng.choice([0.25, 1 / 3, 1 + eps, 2.0], 128).astype(dtype)
    tiny = np.s_[:64]  # results among the subnormal numbers
    x[tiny] *= dtype(2.0) ** (np.finfo(dtype).minexp // 2)
    y[tiny] *= dtype(2.0) ** (np.finfo(dtype).minexp // 2)
    z[tiny] *= np.finfo(dtype).tiny
    s = dtype(1 + eps)

    def exact(x, y, z):
        return np.array(
            [
                rounded(Fraction(float(a)) * Fraction(float(b)) + Fraction(float(c)), dtype)
                for a, b, c in np.broadcast(x, y, z)
            ]
        )

    assert np.count_nonzero(exact(x, y, z) != x * y + z) > 100
    # Zeros without sign: fractions have none.
    operations = {
        "fma(x, y, z) + vector(0)": lambda x, y, z, s: exact(x, y, z),
        "fma(x, s, z) + vector(0)": lambda x, y, z, s: exact(x, s, z),
        "fma(s, x, s) + vector(0)": lambda x, y, z, s: exact(s, x, s),
    }
    assert_rows(vector, operations, x, y, z, s)


def test_fma_of_hard_numbers():
    inf, nan = np.float32(np.inf), np.float32(np.nan)
    cases = [(inf, 0, 1, nan), (inf, 1, -inf, nan), (3e38, 3e38, -inf, -inf), (-0.0, 1, -0.0, -0.0)]
    x, y, z, wanted = (
        np.array(list(column) * 4, np.float32) for column in zip(*cases, strict=True)
    )
    assert_rows(simd.f32x16, {"fma(x, y, z)": lambda x, y, z, s: wanted}, x, y, z, inf)


def test_fma_of_numbers():
    @numba.njit
    def run(x, y, z):
        return simd.fma(x, y, z)

    for eps in (np.float32(2**-23), np.float64(2.0**-52)):
        one = type(eps)(1)
        assert run(one + eps, one + eps, -(one + 2 * eps)) == eps * eps
