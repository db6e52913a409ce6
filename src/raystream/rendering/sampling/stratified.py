"""Jittered strata for a known number of samples: multi-jittered (Chiu, Shirley and Wang 1994).

The samples lie in the cells of a grid of about as many rows as columns, one in each, and in
rows and columns as fine as there are samples, one in each. Where the grid has more cells than
samples, which cells stay empty is chosen at random.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import floor, square_root
from raystream.rendering.sampling.hashing import as_float, mix, stream_key

__all__ = ["sample_number", "sample_pair"]

_1, _32 = np.uint32(1), np.uint64(32)

#: Of a shuffle. After 8 where two of a few elements went together was seen to be uneven, by 28
#: standard deviations over 131,072 keys; after 12 by no more than chance.
_ROUNDS = 12

#: Of the keys that one pair has: for cells, sub-columns, sub-rows, and the two jitters.
_OF_CELL, _OF_X, _OF_Y = np.uint32(0x3C6EF372), np.uint32(0xA54FF53A), np.uint32(0x510E527F)
_OF_JITTER_X, _OF_JITTER_Y = np.uint32(0x9B05688C), np.uint32(0x1F83D9AB)

#: Numbers are multiples of 2**-24, which float32 holds.
_STEPS, _STEP = np.float64(2.0**24), np.float32(2.0**-24)


@device
def _shuffled(x, length, key):
    """Where x of [0, length) comes to lie in a shuffled order; length is 1 to 2**31.

    Each round swaps pairs of places that lie opposite each other around a hashed middle, or
    leaves them, by a hash of the pair: Hoang, Morris and Rogaway, "An Enciphering Scheme Based
    on a Card Shuffle", 2012. It does so for any length, without rejecting.
    """
    x, length = np.uint32(x), np.uint32(length)
    for _ in range(_ROUNDS):
        key = mix(key + _1)
        middle = np.uint32((np.uint64(key) * np.uint64(length)) >> _32)
        other = np.uint32(middle + length - x)
        if other >= length:
            other = np.uint32(other - length)
        if mix(key ^ max(x, other)) & _1:
            x = other
    return x


@device
def _coordinate(cell, fine, jitter, cell_count, fine_count):
    """A number in one cell of many, in one stratum of those in the cell."""
    position = np.float64(cell) * np.float64(fine_count) + np.float64(fine) + np.float64(jitter)
    part = position / (np.float64(cell_count) * np.float64(fine_count))
    return np.float32(floor(part * _STEPS)) * _STEP  # rounded down: never up to 1


@device
def _pair(seed, pixel, sample, pair, sample_count):
    # Samples beyond the count begin another set, as independent of this one as other pixels.
    count = np.uint32(sample_count)
    number = np.uint32(sample)
    own = np.uint32(number % count)
    key = mix(stream_key(seed, pixel, pair) ^ mix(np.uint32(number // count)))

    columns = np.uint32(square_root(np.float64(count)))
    rows = np.uint32(np.uint32(count + columns - _1) // columns)
    cell = _shuffled(own, np.uint32(columns * rows), np.uint32(key ^ _OF_CELL))
    column, row = np.uint32(cell % columns), np.uint32(cell // columns)
    # Each column and each row has a shuffle of its own. With one for all columns and one for
    # all rows, as Kensler has it, errors of smooth functions fall with N**-0.75, not N**-1.
    fine_x = _shuffled(row, rows, np.uint32(mix(key ^ _OF_X) + column))
    fine_y = _shuffled(column, columns, np.uint32(mix(key ^ _OF_Y) + row))
    jitter_x = as_float(mix(mix(key ^ _OF_JITTER_X) ^ mix(own)))
    jitter_y = as_float(mix(mix(key ^ _OF_JITTER_Y) ^ mix(own)))
    return (
        _coordinate(column, fine_x, jitter_x, columns, rows),
        _coordinate(row, fine_y, jitter_y, rows, columns),
    )


@device
def sample_number(seed, pixel, sample, dimension, sample_count):
    """One number of one sample.

    Parameters
    ----------
    seed, pixel, sample, dimension : int
        0 to 2**32 - 1. The number depends on them and on the count alone.
    sample_count : int
        1 to 2**24. Samples from there on begin another set.

    Returns
    -------
    float32
        In [0, 1). If floor(sqrt(sample_count)) divides the count, each interval of length
        1 / sample_count gets one of a set's numbers; if not, the strata are a little finer,
        and some stay empty.

    References
    ----------
    .. [1] Chiu, Shirley and Wang, "Multi-Jittered Sampling", Graphics Gems IV, 1994.
    .. [2] Kensler, "Correlated Multi-Jittered Sampling", Pixar Technical Memo 13-01, 2013: the
       shuffle as a function of its key, and counts that fill no grid.
    """
    dimension = np.uint32(dimension)
    x, y = _pair(seed, pixel, sample, dimension >> _1, sample_count)
    return y if dimension & _1 else x


@device
def sample_pair(seed, pixel, sample, dimension, sample_count):
    """The numbers of a dimension and of the next, two float32; see `sample_number`.

    Let the dimension be even: only then do the two lie in the cells of one grid.
    """
    dimension = np.uint32(dimension)
    if dimension & _1:
        following = np.uint32(dimension + _1)
        return (
            sample_number(seed, pixel, sample, dimension, sample_count),
            sample_number(seed, pixel, sample, following, sample_count),
        )
    return _pair(seed, pixel, sample, dimension >> _1, sample_count)
