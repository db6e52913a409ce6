"""Single operations that kernels use."""

from __future__ import annotations

import numpy as np
import pytest
from numba.core.errors import TypingError

from raystream.jit.cpu import kernel
from raystream.jit.intrinsics import corners_at
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
