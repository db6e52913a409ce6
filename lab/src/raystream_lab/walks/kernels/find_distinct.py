"""Find rays whose walks are equal."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device, kernel

#: A free entry of the table.
FREE = np.uint32(2**32 - 1)

_KERNEL_BITS = np.uint64(3)
_HALF_BITS = np.uint64(32)

#: Odd, from the golden ratio (Knuth, The Art of Computer Programming 3, section 6.4).
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


@device
def _hash(kernels, lengths, begin, end):
    value = end - begin
    for row in range(begin, end):
        value ^= np.uint64(lengths[row]) << _KERNEL_BITS | np.uint64(kernels[row])
        value *= _MULTIPLIER
        value ^= value >> _HALF_BITS
    return value


@device
def _are_same(kernels, lengths, a, b, count):
    for k in range(count):
        if kernels[a + k] != kernels[b + k] or lengths[a + k] != lengths[b + k]:
            return False
    return True


@kernel
def find_distinct(splits, kernels, lengths, table, firsts, weights):
    """Find the first ray of each distinct walk, and the number of rays that take it.

    Parameters
    ----------
    splits, kernels, lengths : ndarray
        The runs of N rays; see `Walks`.
    table : ndarray of shape (T,), uint32
        Filled with `FREE`; T is a power of two above N.
    firsts, weights : ndarray of shape (N,), uint32
        Written per distinct walk, in the order of the first rays.

    Returns
    -------
    int
        Number of distinct walks.
    """
    found = ZERO_U64
    mask = np.uint64(len(table)) - ONE_U64
    for ray in range(np.uint64(len(firsts))):
        begin, end = np.uint64(splits[ray]), np.uint64(splits[ray + ONE_U64])
        place = _hash(kernels, lengths, begin, end) & mask
        while True:
            walk = np.uint64(table[place])
            if walk == np.uint64(FREE):
                table[place] = np.uint32(found)
                firsts[found] = np.uint32(ray)
                weights[found] = np.uint32(1)
                found += ONE_U64
                break
            other = np.uint64(firsts[walk])
            first, last = np.uint64(splits[other]), np.uint64(splits[other + ONE_U64])
            is_long = last - first == end - begin
            if is_long and _are_same(kernels, lengths, begin, first, end - begin):
                weights[walk] += np.uint32(1)
                break
            place = (place + ONE_U64) & mask
    return np.int64(found)
