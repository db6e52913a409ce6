"""Scans and sorts on the device agree with NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from extras import need

need("numba_cuda")

from conftest import skip_without_cuda
from raystream.jit.cuda import is_simulated, open_gpu
from raystream.jit.cuda.radix_sort import sort_pairs
from raystream.jit.cuda.scan import Scan, TileSize

#: Tiles so small that a short array takes several, and their sums several again.
SMALL = TileSize(16, 1)

few = settings(max_examples=4, derandomize=True)


@pytest.fixture(autouse=True)
def device():
    """Skips without one."""
    skip_without_cuda()


def scanned(numbers, size):
    gpu = open_gpu()
    given_ones = gpu.upload("numbers", numbers)
    out = gpu.empty("sums", len(numbers) + 1, numbers.dtype)
    Scan(gpu, len(numbers), size).run(given_ones.address, len(numbers), out.address, numbers.dtype)
    return out.host()


@few
@given(
    count=st.sampled_from([1, 15, 16, 17, 290]),
    dtype=st.sampled_from([np.uint32, np.int64]),
    seed=st.integers(0, 99),
)
def test_scan_adds_up_what_comes_before(count, dtype, seed):
    numbers = np.random.default_rng(seed).integers(0, 1 << 20, count).astype(dtype)
    expected = np.concatenate([[0], np.cumsum(numbers)]).astype(dtype)
    assert scanned(numbers, SMALL).tolist() == expected.tolist()


def test_scan_in_place_and_by_several_items():
    gpu = open_gpu()
    numbers = np.arange(40, dtype=np.uint32)
    array = gpu.upload("numbers", np.append(numbers, np.uint32(7)))
    Scan(gpu, 40, TileSize(16, 2)).run(array.address, 40, array.address, np.uint32)
    assert array.host().tolist() == [0, *np.cumsum(numbers).tolist()]


def test_scan_refuses_lengths_it_has_no_room_for():
    with pytest.raises(ValueError, match="count: expected 1 to 40, got 41"):
        Scan(open_gpu(), 40, SMALL).run(0, 41, 0, np.uint32)
    with pytest.raises(ValueError, match="got 0"):
        Scan(open_gpu(), 40, SMALL).run(0, 0, 0, np.uint32)


def pairs_of(keys, bits, size):
    gpu = open_gpu()
    values = np.arange(len(keys), dtype=np.uint32)
    sorted_ones = sort_pairs(
        gpu, gpu.upload("keys", keys), gpu.upload("values", values), bits, size
    )
    return [one.host() for one in sorted_ones]


@few
@given(
    count=st.sampled_from([1, 2, 16, 33, 70]),
    wide=st.booleans(),
    bits=st.sampled_from([1, 4, 6]),
    seed=st.integers(0, 99),
)
def test_sort_is_stable(count, wide, bits, seed):
    """Few bits, so that many keys are equal."""
    keys = np.random.default_rng(seed).integers(0, 1 << bits, count)
    keys = keys.astype(np.uint64 if wide else np.uint32)
    found, values = pairs_of(keys, bits, SMALL)
    order = np.argsort(keys, kind="stable")
    assert found.tolist() == keys[order].tolist()
    assert values.tolist() == order.tolist()


def test_sort_by_several_items_and_long_keys():
    keys = np.random.default_rng(1).integers(0, 2**36, 40, np.uint64)
    keys[7] = keys[3]
    found, values = pairs_of(keys, 36, TileSize(16, 2))
    order = np.argsort(keys, kind="stable")
    assert found.tolist() == keys[order].tolist()
    assert values.tolist() == order.tolist()


@pytest.mark.skipif(is_simulated(), reason="only a GPU takes them in good time")
@pytest.mark.parametrize("count", [100_000, 3_000_001])
def test_long_arrays(count):
    keys = np.random.default_rng(2).integers(0, 2**30, count, np.uint32)
    from raystream.jit.cuda.scan import DEFAULT_TILE

    found, values = pairs_of(keys, 30, DEFAULT_TILE)
    order = np.argsort(keys, kind="stable")
    assert np.array_equal(found, keys[order])
    assert np.array_equal(values, order)
    sums = scanned(keys.astype(np.int64), DEFAULT_TILE)
    assert np.array_equal(sums[1:], np.cumsum(keys, dtype=np.int64))
