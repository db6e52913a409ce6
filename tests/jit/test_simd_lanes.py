"""Choosing, moving, reducing and converting lanes, against NumPy."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import pytest

from jit.vector_types import DTYPES, FLOAT_TYPES, VECTOR_TYPES
from raystream.jit import simd
from raystream.jit.cpu import device
from raystream.jit.simd import address, select, store
from raystream.jit.simd.types import VECTORS


@device
def at(array, i):
    return address(array) + np.uint64(i * array.itemsize)


REVERSE = {n: simd.permutation(*reversed(range(n))) for n in (4, 8, 16)}
UPPER = {n: simd.permutation(*range(n // 2, n)) for n in (4, 8, 16)}
TWICE = {n: simd.permutation(*range(n), *range(n)) for n in (4, 8)}


@cache
def lane_kernel(vector):
    n = vector.lane_count
    mask_type = VECTORS["mask", n]
    sources_type = VECTORS["i" + vector.kind[1:], n]
    reverse, upper = REVERSE[n], UPPER[n]
    load, lane = simd.load, simd.lane

    @numba.njit
    def run(a, bits, sources, out, single):
        x = load(vector, address(a))
        mask = simd.lanes_from_bits(mask_type, bits)
        store(at(out[0], 0), simd.compress(mask, x))
        store(at(out[1], 0), simd.permute(x, load(sources_type, address(sources))))
        store(at(out[2], 0), reverse(x))
        store(at(out[3], 0), upper(x))
        store(at(out[4], 0), select(mask, x, vector(0)))
        single[0] = simd.reduce_min(x)
        single[1] = simd.reduce_max(x)
        for i in range(n):
            single[2 + i] = lane(x, i)

    return run


@pytest.mark.parametrize("vector", VECTOR_TYPES, ids=str)
def test_lanes_move(vector, rng):
    n = vector.lane_count
    dtype = DTYPES[vector.kind]
    kernel = lane_kernel(vector)
    all_bits = 2**n - 1
    for bits in [0, all_bits, 1, 2 ** (n - 1), *rng.integers(0, all_bits, 60).tolist()]:
        x = rng.integers(-1000, 1000, n).astype(dtype)
        sources = rng.integers(-50, 50, n).astype(f"i{x.itemsize}")
        out, single = np.zeros((5, n), dtype), np.empty(2 + n, dtype)
        kernel(x, bits, sources, out, single)
        kept = (bits >> np.arange(n)) & 1 == 1
        np.testing.assert_array_equal(out[0, : kept.sum()], x[kept])
        np.testing.assert_array_equal(out[1], x[sources % n])
        np.testing.assert_array_equal(out[2], x[::-1])
        np.testing.assert_array_equal(out[3], [*x[n // 2 :], *np.zeros(n // 2)])
        np.testing.assert_array_equal(out[4], np.where(kept, x, 0))
        np.testing.assert_array_equal(single, [x.min(), x.max(), *x])


@pytest.mark.parametrize("n", [4, 8])
def test_permutation_to_more_lanes(n):
    vector, twice = VECTORS["f32", n], TWICE[n]

    @numba.njit
    def run(a, out):
        store(address(out), twice(simd.load(vector, address(a))))

    a, out = np.arange(n, dtype=np.float32), np.empty(2 * n, np.float32)
    run(a, out)
    np.testing.assert_array_equal(out, [*a, *a])


@pytest.mark.parametrize(
    "sources", [(), (0,), (0, 1, 2), (0, -1), tuple(range(32))], ids=lambda s: str(len(s))
)
def test_permutation_refuses_other_lane_counts(sources):
    with pytest.raises(ValueError, match="a permutation has 2, 4, 8 or 16 sources"):
        simd.permutation(*sources)


@pytest.mark.parametrize("vector", FLOAT_TYPES, ids=str)
def test_reductions_of_infinite_lanes(vector):
    n = vector.lane_count
    for i in range(n):
        x = np.full(n, np.inf, DTYPES[vector.kind])
        x[i] = -np.inf
        single = np.empty(2 + n, x.dtype)
        lane_kernel(vector)(x, 0, np.zeros(n, f"i{x.itemsize}"), np.empty((5, n), x.dtype), single)
        assert single[:2].tolist() == [-np.inf, np.inf]


# ---- Masks.


@pytest.mark.parametrize("n", [4, 8, 16])
def test_masks(n, rng):
    mask_type, reverse = VECTORS["mask", n], REVERSE[n]
    mask_bits, lanes_from_bits = simd.mask_bits, simd.lanes_from_bits

    @numba.njit
    def run(a, b, flag, out, lanes):
        x, y = lanes_from_bits(mask_type, a), lanes_from_bits(mask_type, b)
        out[0] = mask_bits(x & y)
        out[1] = mask_bits(x | y)
        out[2] = mask_bits(x ^ y)
        out[3] = mask_bits(~x)
        out[4] = mask_bits(x & flag)
        out[5] = mask_bits(flag | x)
        out[6] = mask_bits(select(x, y, ~y))
        out[7] = mask_bits(select(flag, x, y))
        out[8] = mask_bits(mask_type(flag))
        out[9] = mask_bits(reverse(x))
        out[10] = simd.popcount(mask_bits(x))
        out[11] = simd.count_trailing_zeros(mask_bits(x) | np.uint64(2**n))
        out[12] = 1 if simd.any_lane(x) else 0
        out[13] = 1 if simd.all_lanes(x) else 0
        x &= y
        out[14] = mask_bits(x)
        x |= flag
        out[15] = mask_bits(x)
        x ^= y
        out[16] = mask_bits(x)
        for i in range(n):
            lanes[i] = simd.lane(y, i) and simd.lane(x, i) == simd.lane(y, i)

    every = 2**n - 1
    cases = range(2**n) if n < 16 else [0, every, 1, 2**15, *rng.integers(0, every, 300).tolist()]
    for a in cases:
        b = int(rng.integers(0, every + 1))
        flag = bool(rng.integers(2))
        all_or_none = every * flag
        out, lanes = np.empty(17, np.uint64), np.empty(n, np.bool_)
        run(a, b, flag, out, lanes)
        last = ((a & b) | all_or_none) ^ b
        assert out.tolist() == [
            *(a & b, a | b, a ^ b, a ^ every, a & all_or_none, a | all_or_none),
            (a & b) | ((a ^ every) & (b ^ every)),
            a if flag else b,
            all_or_none,
            int(f"{a:0{n}b}"[::-1], 2),
            a.bit_count(),
            ((a | 2**n) & -(a | 2**n)).bit_length() - 1,
            int(a != 0),
            int(a == every),
            *(a & b, (a & b) | all_or_none, last),
        ]
        assert lanes.tolist() == [bool((b & last) >> i & 1) for i in range(n)]


@pytest.mark.parametrize("bits", [1, 2**31, 2**32, 2**63, 2**64 - 1])
def test_bits_of_64(bits):
    @numba.njit
    def run(bits):
        return simd.count_trailing_zeros(bits), simd.popcount(bits)

    assert run(np.uint64(bits)) == ((bits & -bits).bit_length() - 1, bits.bit_count())


# ---- Conversions.


@pytest.mark.parametrize("n", [4, 8, 16])
def test_conversions(n, rng):
    f32, f64, i32, i64 = (VECTORS[kind, n] for kind in DTYPES)

    @numba.njit
    def run(a32, a64, b32, b64, f32_out, f64_out, i32_out, i64_out):
        for i in range(0, a32.size, n):
            x32, x64 = simd.load(f32, at(a32, i)), simd.load(f64, at(a64, i))
            y32, y64 = simd.load(i32, at(b32, i)), simd.load(i64, at(b64, i))
            store(at(f32_out[0], i), f32(x64))
            store(at(f32_out[1], i), f32(y32))
            store(at(f32_out[2], i), f32(y64))
            store(at(f32_out[3], i), simd.narrow(x64))
            store(at(f32_out[4], i), simd.bits_as_float(y32))
            store(at(f64_out[0], i), f64(x32))
            store(at(f64_out[1], i), f64(y32))
            store(at(f64_out[2], i), f64(y64))
            store(at(f64_out[3], i), simd.widen(x32))
            store(at(f64_out[4], i), simd.bits_as_float(y64))
            store(at(i32_out[0], i), i32(x32))
            store(at(i32_out[1], i), i32(x64))
            store(at(i32_out[2], i), i32(y64))
            store(at(i32_out[3], i), simd.float_as_bits(x32))
            store(at(i64_out[0], i), i64(x32))
            store(at(i64_out[1], i), i64(x64))
            store(at(i64_out[2], i), i64(y32))
            store(at(i64_out[3], i), simd.float_as_bits(x64))

    x64 = np.array(
        [0.0, -0.0, 0.99, -0.99, 1.5, -1.5, 2.5, 1 + 2**-24, 1 + 3 * 2**-24, -7e8, 5e-40]
    )
    x64 = np.concatenate([x64, rng.uniform(-2e9, 2e9, 64 - x64.size)])
    x32 = np.where(np.abs(x64) < 2e9, x64, 0).astype(np.float32)
    y64 = rng.integers(-(2**63), 2**63 - 1, 64)
    y64[:4] = 2**53 + 1, 2**24 + 1, -(2**63), 2**63 - 1
    y32 = rng.integers(-(2**31), 2**31 - 1, 64, np.int32)
    f32_out, f64_out = np.empty((5, 64), np.float32), np.empty((5, 64))
    i32_out, i64_out = np.empty((4, 64), np.int32), np.empty((4, 64), np.int64)
    run(x32, x64, y32, y64, f32_out, f64_out, i32_out, i64_out)

    def check(out, *wanted):
        assert out.tobytes() == np.stack(wanted).tobytes()

    as32, as64 = x64.astype(np.float32), x32.astype(np.float64)
    floats32, floats64 = y32.view(np.float32), y64.view(np.float64)
    check(f32_out, as32, y32.astype(np.float32), y64.astype(np.float32), as32, floats32)
    check(f64_out, as64, y32.astype(np.float64), y64.astype(np.float64), as64, floats64)
    ints32, ints64 = x32.astype(np.int32), x32.astype(np.int64)
    check(i32_out, ints32, x64.astype(np.int32), y64.astype(np.int32), x32.view(np.int32))
    check(i64_out, ints64, x64.astype(np.int64), y32.astype(np.int64), x64.view(np.int64))


def test_narrow_overflows_to_infinity():
    @numba.njit
    def run(x):
        return simd.lane(simd.narrow(simd.f64x4(x)), 1)

    assert [run(x) for x in (1e300, -1e300, 1e-300, np.inf)] == [np.inf, -np.inf, 0, np.inf]
    assert np.isnan(run(np.nan))


def test_numbers_of_any_type_fill_vectors():
    @numba.njit
    def run(integer, single, flag):
        return (
            simd.lane(simd.f32x8(integer), 7),
            simd.lane(simd.i32x4(single), 3),
            simd.lane(simd.f64x4(single), 0),
            simd.lane(simd.i64x4(flag), 0),
            simd.lane(simd.f32x4(0.1), 0),
            simd.mask_bits(simd.mask8(integer)),
        )

    assert run(3, np.float32(-1.5), True) == (3.0, -1, -1.5, 1, float(np.float32(0.1)), 255)


def test_bits_of_numbers():
    @numba.njit
    def run(x, y, i, j):
        return (
            simd.float_as_bits(x),
            simd.float_as_bits(y),
            simd.bits_as_float(i),
            simd.bits_as_float(j),
        )

    one32, one64 = 0x3F800000, 0x3FF << 52
    given = np.float32(1.0), 1.0, np.int32(one32), np.int64(one64)
    assert run(*given) == (one32, one64, 1.0, 1.0)
