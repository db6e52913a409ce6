"""Discrete distributions: cumulative probabilities, and sampling by inversion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    any_lane,
    as_int32,
    gather,
    i32x16,
    load,
    maximum,
    minimum,
    narrow,
    select,
)

_LONG = np.uint64(8)
_0, _1 = np.int32(0), np.int32(1)
_NULL, _MOST = np.float32(0.0), np.float32(1.0 - 2.0**-24)


def running_sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cumulative probabilities of weights; the last one that is not 0 ends at exactly 1."""
    ends = np.cumsum(values)
    if len(ends) and ends[-1] > 0.0:
        ends /= ends[-1]
        ends[np.flatnonzero(values)[-1] :] = 1.0
    return ends


@device
def double(at, k):
    """Element k of float64 numbers at an address."""
    return load(np.float64, at + k * _LONG)


@device
def sample_discrete(ends, count, number):
    """Sample an index; return its probability, and the position of the number within its interval.

    Parameters
    ----------
    ends : uint64
        Address of the cumulative probabilities, float64.
    count : uint64
    number : float64
        In [0, 1).

    Returns
    -------
    index : uint64
    share, within : float64
        `within` is in [0, 1).
    """
    low, high = ZERO_U64, count
    while high - low > ONE_U64:
        middle = (low + high) >> ONE_U64
        if double(ends, middle - ONE_U64) <= number:
            low = middle
        else:
            high = middle
    start = double(ends, low - ONE_U64) if low != ZERO_U64 else 0.0
    share = double(ends, low) - start
    within = (number - start) / share if share > 0.0 else 0.0
    return low, share, min(max(within, 0.0), 1.0 - 2.0**-53)


@device
def sample_discrete_lanes(ends, count, number):
    """`sample_discrete` for 16 numbers.

    Parameters
    ----------
    ends : uint64
        Address of cumulative probabilities, float64.
    count : uint64
        Number of them.
    number : f64x16
        In [0, 1).

    Returns
    -------
    index : i32x16
    share : f64x16
    within : f32x16
    """
    low, high = i32x16(_0), i32x16(as_int32(count))
    is_open = high - low > _1
    while any_lane(is_open):
        middle = (low + high) >> _1
        is_above = gather(np.float64, ends, maximum(middle - _1, _0)) <= number
        low = select(is_open & is_above, middle, low)
        high = select(is_open & ~is_above, middle, high)
        is_open = high - low > _1
    start = select(low > _0, gather(np.float64, ends, maximum(low - _1, _0)), 0.0)
    share = gather(np.float64, ends, low) - start
    within = narrow(number - start) / narrow(share)
    # Clamped also where a probability is 0.
    return low, share, minimum(maximum(within, _NULL), _MOST)
