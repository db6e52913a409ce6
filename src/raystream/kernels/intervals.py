"""The interval that a number is in, by binary search."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import BYTES_64, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load


def halvings_of(count: int) -> int:
    """The steps of the search of `interval_of` among a number of intervals."""
    return max(count - 1, 0).bit_length()


@device
def interval_of(splits, count, halvings, number):
    """The last of `count` intervals that begins at or before a number; the splits are int64.

    Binary search of a fixed number of steps, which LLVM removes where it is not used.
    """
    low, high = ZERO_U64, count
    for _ in range(halvings):
        middle = (low + high) >> ONE_U64
        is_above = load(np.int64, splits + middle * BYTES_64) <= number
        low = middle if is_above else low
        high = high if is_above else middle
    return low
