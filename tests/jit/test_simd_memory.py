"""Vectors in memory, in calls and in loops."""

from __future__ import annotations

import re

import numba
import numpy as np
import pytest

from jit.vector_types import DTYPES, VECTOR_TYPES
from raystream.jit import simd
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import (
    address,
    f32x8,
    f32x16,
    f64x8,
    f64x16,
    load,
    load_triples,
    scratch,
    select,
    store,
    store_nontemporal,
    store_records,
    store_triples,
)


@device
def at(array, i):
    return address(array) + np.uint64(i * array.itemsize)


@pytest.mark.parametrize("vector", VECTOR_TYPES, ids=str)
def test_vectors_start_at_any_element(vector):
    n = vector.lane_count

    @numba.njit
    def run(a, out):
        for i in range(a.size - n + 1):
            store(at(out[i], 1), load(vector, at(a, i)))

    a = np.arange(3 * n).astype(DTYPES[vector.kind])
    out = np.full((a.size - n + 1, n + 3), -1, a.dtype)
    run(a, out)
    np.testing.assert_array_equal(out[:, 1:-2], np.lib.stride_tricks.sliding_window_view(a, n))
    assert (out[:, [0, -2, -1]] == -1).all()


@pytest.mark.parametrize(
    "dtype", [*DTYPES.values(), np.int8, np.int16, np.uint8, np.uint16, np.uint32, np.uint64]
)
def test_numbers_in_memory(dtype):
    @numba.njit
    def run(a, out):
        for i in range(a.size):
            store(at(out, i), load(dtype, at(a, i)))

    limits = np.finfo(dtype) if issubclass(dtype, np.floating) else np.iinfo(dtype)
    a = np.array([0, 1, limits.min, limits.max, 77], dtype)
    out = np.empty_like(a)
    run(a, out)
    assert out.tobytes() == a.tobytes()


def test_the_address_of_a_view_is_that_of_its_first_element():
    @numba.njit
    def run(a):
        return address(a)

    a = np.zeros((4, 6), np.float32)
    for view in (a, a[1:, 2:], a[::-1], a.T[3], a[:0]):
        assert run(view) == view.ctypes.data


SIZE = 96


def test_scratch():
    @numba.njit
    def run(a, out):
        for i in range(3):
            first, second = scratch(SIZE), scratch(1)
            out[0, i], out[1, i] = first, second
            store(second, np.uint8(i))
            store(first, load(simd.f32x16, address(a)))
            store(first + np.uint64(64), load(simd.f32x8, at(a, 16)))
            out[2, i] = load(np.uint8, second)
            for k in range(24):
                out[3, i] += np.uint64(load(np.float32, first + np.uint64(4 * k)))

    out = np.zeros((4, 3), np.uint64)
    run(np.arange(24, dtype=np.float32), out)
    first, second, numbers, sums = out.tolist()
    assert len(set(first)) == len(set(second)) == 1
    assert first[0] % 64 == second[0] % 64 == 0
    assert not first[0] <= second[0] < first[0] + SIZE
    assert numbers == [0, 1, 2]
    assert sums == [276, 276, 276]


def test_prefetch_is_an_instruction_that_takes_any_address():
    @numba.njit
    def run(at):
        simd.prefetch(at)

    for place in (0, 1, 2**63, 2**64 - 1, np.zeros(1).ctypes.data):
        run(np.uint64(place))
    (code,) = run.inspect_llvm().values()
    (call, *_) = re.findall(r"call void @llvm\.prefetch\.p0[^\n]*", code)
    assert call.endswith("i32 0, i32 3, i32 1)")  # to read, in all caches, data


@device_call
def halves(x, mask):
    """Not inlined: vectors and masks are arguments and results."""
    return select(mask, x, -x), mask, (x, simd.f64x16(2.0))


def test_vectors_pass_through_calls_and_loops():
    @numba.njit
    def run(a, count, out):
        total = simd.f32x8(0)
        mask = simd.mask8(False)
        for i in range(count):
            x = simd.load(simd.f32x8, at(a, 8 * i))
            signed, mask, pair = halves(x, x > simd.lane(x, 3))
            if simd.any_lane(mask):
                total += signed + pair[0]
        store(address(out), total)
        return simd.mask_bits(mask)

    a = np.arange(32, dtype=np.float32)
    out = np.empty(8, np.float32)
    assert run(a, 4, out) == 0b11110000
    np.testing.assert_array_equal(out, np.where(np.arange(8) > 3, 2 * a.reshape(4, 8).sum(0), 0))


@kernel
def _copy_past_cache(source, to):
    store_nontemporal(address(to), load(f32x16, address(source)))


def test_store_past_cache():
    memory = np.zeros(32, np.float32)
    skipped = -memory.ctypes.data % 64 // 4
    to = memory[skipped : skipped + 16]
    _copy_past_cache(np.arange(16, dtype=np.float32), to)
    assert to.tolist() == list(range(16))


@kernel
def _transpose(source, to):
    x, y, z = load_triples(f64x8, address(source))
    store(address(to), x)
    store(address(to) + np.uint64(64), y)
    store(address(to) + np.uint64(128), z)


def test_load_triples():
    points = np.random.default_rng(1).random((8, 3))
    to = np.empty((3, 8))
    _transpose(points, to)
    assert to.tolist() == points.T.tolist()


@device
def _load_four(vector, rows, step):
    at = address(rows)
    return (
        load(vector, at),
        load(vector, at + step),
        load(vector, at + step + step),
        load(vector, at + step + step + step),
    )


@kernel
def _store_records(wide, short, to):
    store_records(address(to), _load_four(f64x16, wide, np.uint64(128)))
    step = np.uint64(64)
    first, second = _load_four(f32x16, short, step), _load_four(f32x16, short[4:], step)
    third, fourth = _load_four(f32x16, short[8:], step), _load_four(f32x16, short[12:], step)
    store_records(address(to) + np.uint64(512), first + second + third + fourth)


def test_store_records():
    rng = np.random.default_rng(3)
    wide, short = rng.random((4, 16)), rng.random((16, 16), np.float32)
    to = np.empty(192)
    _store_records(wide, short, to)
    assert to[:64].tolist() == wide.T.ravel().tolist()
    assert to[64:].view(np.float32).tolist() == short.T.ravel().tolist()


@kernel
def store_three(numbers, out):
    x, y, z = load_triples(f32x8, address(numbers))
    store_triples(address(out), z, x, y)


@kernel
def store_three_wide(numbers, out):
    x, y, z = load_triples(f64x16, address(numbers))
    store_triples(address(out), z, x, y)


@pytest.mark.parametrize(
    ("run", "dtype", "count"), [(store_three, np.float32, 8), (store_three_wide, np.float64, 16)]
)
def test_store_triples(run, dtype, count):
    numbers = np.random.default_rng(3).random((count, 3)).astype(dtype)
    out = np.zeros((count + 1, 3), dtype)
    run(numbers, out)
    np.testing.assert_array_equal(out[:count], np.roll(numbers, 1, axis=1))
    np.testing.assert_array_equal(out[count], 0.0)
