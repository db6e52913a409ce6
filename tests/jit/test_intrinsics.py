"""Single operations that kernels use."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core.errors import TypingError

from raystream.jit.cpu import kernel
from raystream.jit.intrinsics import (
    bits_above,
    corners_at,
    high_product,
    sum_above,
)
from raystream.jit.simd import address


def test_corners_are_read_from_an_address(rng):
    @kernel
    def read(array, i, j, k):
        return corners_at(address(array))[i, j, k]

    corners = rng.random((5, 3, 3)).astype(np.float32)
    for place in np.ndindex(corners.shape):
        assert read(corners, *place) == corners[place]


def test_corners_cannot_be_written_or_read_from_elsewhere():
    @kernel
    def write(array):
        corners_at(address(array))[0, 0, 0] = 1.0

    @kernel
    def read(array):
        return corners_at(array)

    with pytest.raises(TypingError):
        write(np.zeros((1, 3, 3), np.float32))
    with pytest.raises(TypingError):
        read(np.zeros((1, 3, 3), np.float32))


def test_high_product_is_the_upper_half(rng):
    @kernel
    def product(a, b):
        return high_product(a, b)

    numbers = [0, 1, 48, 2**32, 2**63, 2**64 - 1, *rng.integers(0, 2**63, 20).tolist()]
    for a in numbers:
        for b in numbers:
            assert product(np.uint64(a), np.uint64(b)) == (a * b) >> 64
    with pytest.raises(TypingError):
        product(np.uint64(1), 1.0)


def test_sums_above_a_place(rng):
    @kernel
    def sums(array, k):
        return sum_above(address(array), k), bits_above(address(array), k)

    array = rng.integers(0, 2**63, 65).astype(np.uint64)[1:]  # of a vector's alignment or not
    for k in range(64):
        above = array[k + 1 :]
        expected = int(above.sum(dtype=np.uint64)), int(np.bitwise_count(above).sum())
        assert sums(array, np.uint64(k)) == expected
    with pytest.raises(TypingError):
        sums(array, 1.0)
