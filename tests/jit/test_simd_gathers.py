"""Gathers and scatters, and vectors of unsigned numbers."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core.errors import TypingError

from raystream.jit.cpu import kernel
from raystream.jit.simd import (
    address,
    as_float32,
    as_int32,
    as_uint32,
    f32x16,
    gather,
    i32x16,
    i64x16,
    lane_numbers,
    lanes_from_bits,
    load,
    mask16,
    maximum,
    minimum,
    narrow_lanes,
    prefix_counts,
    scatter,
    select,
    store,
    u32x16,
    widen_number,
)

RANDOM = np.random.default_rng(5)


@kernel
def take_float32(numbers, index, out):
    for i in range(len(index) // 16):
        places = load(i32x16, address(index) + np.uint64(64 * i))
        at = address(out) + np.uint64(64 * i)
        low = gather(np.float32, address(numbers), places)
        same = gather(np.float32, address(numbers), i64x16(places))
        again = gather(np.float32, address(numbers), as_uint32(places))
        store(at, select((low == same) & (low == again), low, np.float32(-1.0)))


@kernel
def take_float64(numbers, index, out):
    for i in range(len(index) // 16):
        places = load(i32x16, address(index) + np.uint64(64 * i))
        store(address(out) + np.uint64(128 * i), gather(np.float64, address(numbers), places))


@kernel
def take_one(numbers, i):
    return gather(np.float32, address(numbers), i)


@pytest.mark.parametrize(("run", "dtype"), [(take_float32, np.float32), (take_float64, np.float64)])
def test_gather(run, dtype):
    numbers = RANDOM.random(1000).astype(dtype)
    index = RANDOM.integers(0, 1000, 160).astype(np.int32)
    index[:2] = 0, 999
    out = np.empty(160, dtype)
    run(numbers, index, out)
    np.testing.assert_array_equal(out, numbers[index])


def test_gather_of_one():
    numbers = RANDOM.random(10).astype(np.float32)
    assert take_one(numbers, 7) == numbers[7]
    assert take_one(numbers[5:], -2) == numbers[3]


@kernel
def put(out, index, values, bits):
    mask = lanes_from_bits(mask16, bits)
    scatter(address(out), load(i32x16, address(index)), load(f32x16, address(values)), mask)
    scatter(address(out), 20, np.float32(20.0), bits != 0)
    scatter(address(out), 21, np.float32(21.0), bits == 0)


@pytest.mark.parametrize("bits", [0, 0x8001, 0xFFFF, 0x00F0])
def test_scatter(bits):
    index, values = RANDOM.permutation(16).astype(np.int32), RANDOM.random(16).astype(np.float32)
    out, expected = np.zeros(22, np.float32), np.zeros(22, np.float32)
    put(out, index, values, np.uint64(bits))
    is_set = (bits >> np.arange(16)) & 1 == 1
    expected[index[is_set]] = values[is_set]
    expected[20 if bits else 21] = 20 if bits else 21
    np.testing.assert_array_equal(out, expected)


def test_scatter_of_equal_places():
    """The last lane counts."""
    out, values = np.zeros(22, np.float32), np.arange(16, dtype=np.float32)
    put(out, np.full(16, 3, np.int32), values, np.uint64(0x0FFF))
    assert out[3] == 11.0


@kernel
def number_lanes(out, bits):
    store(address(out), lane_numbers(i32x16))
    store(address(out) + np.uint64(64), prefix_counts(lanes_from_bits(mask16, bits)))


@pytest.mark.parametrize("bits", [0, 0xFFFF, 0b1011001110001101])
def test_lane_numbers_and_ranks(bits):
    out = np.empty((2, 16), np.int32)
    number_lanes(out, np.uint64(bits))
    np.testing.assert_array_equal(out[0], np.arange(16))
    is_set = (bits >> np.arange(16)) & 1
    np.testing.assert_array_equal(out[1], np.cumsum(is_set) - is_set)


@kernel
def unsigned(a, b, out, floats):
    x, y = load(u32x16, address(a)), load(u32x16, address(b))
    row = np.uint64(64)
    at = address(out)
    store(at, x * y + np.uint32(0x9E3779B9))
    store(at + row, x >> np.uint32(7))
    store(at + row + row, minimum(x, y))
    store(at + row + row + row, select(x < y, x, as_uint32(as_int32(maximum(x, y)))))
    store(address(floats), as_float32(x))


def test_unsigned():
    a = RANDOM.integers(0, 1 << 32, 16).astype(np.uint32)
    b = RANDOM.integers(0, 1 << 32, 16).astype(np.uint32)
    a[:2], b[:2] = (0xFFFFFFFF, 0), (1, 0x80000000)
    out, floats = np.empty((4, 16), np.uint32), np.empty(16, np.float32)
    unsigned(a, b, out, floats)
    expected = [a * b + np.uint32(0x9E3779B9), a >> np.uint32(7)]
    expected += [np.minimum(a, b), np.where(a < b, a, np.maximum(a, b))]
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(floats, a.astype(np.float32))


@kernel
def convert_numbers(x, y):
    wide = widen_number(x)
    return wide, narrow_lanes(y), as_float32(y), as_int32(-2.7), as_uint32(-1), minimum(x, y)


def test_numbers_convert_as_lanes_do():
    x, y = np.float32(0.1), 1.0 + 2.0**-30
    wide, same, narrowed, whole, wrapped, least = convert_numbers(x, y)
    assert (wide, same, narrowed, whole) == (float(x), y, 1.0, -2)
    assert (wrapped, least) == (2**32 - 1, float(x))


@kernel
def gather_masks(numbers):
    return gather(np.bool_, address(numbers), 0)


def test_errors():
    with pytest.raises(TypingError, match="gather takes a number type"):
        gather_masks(np.zeros(4, np.float32))
