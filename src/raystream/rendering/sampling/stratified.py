"""Multi-jittered samples, for a known number of them (Chiu, Shirley and Wang 1994).

The cells of a roughly square grid have a sample each, and so have as many fine rows and columns as
there are samples. If the grid has more cells than samples, random cells stay empty.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import floor, square_root
from raystream.rendering.sampling.hashing import as_float, mix, stream_key

_1, _32 = np.uint32(1), np.uint64(32)

#: Of a shuffle. After 8 the joint position of two of a few elements is biased, by 28 standard
#: deviations over 131,072 keys; after 12 by no more than chance.
_ROUNDS = 12

#: Of a pair's keys: for cells, fine columns, fine rows, and the two jitters.
_OF_CELL, _OF_X, _OF_Y = np.uint32(0x3C6EF372), np.uint32(0xA54FF53A), np.uint32(0x510E527F)
_OF_JITTER_X, _OF_JITTER_Y = np.uint32(0x9B05688C), np.uint32(0x1F83D9AB)

#: Numbers are multiples of 2**-24, exact in float32.
_STEPS, _STEP = np.float64(2.0**24), np.float32(2.0**-24)


@device
def _shuffled(x, length, key):
    """Position of x of [0, length) in a random permutation; length is 1 to 2**31.

    Each round swaps, by a hash, pairs of positions opposite each other around a hashed centre:
    Hoang, Morris and Rogaway, "An Enciphering Scheme Based on a Card Shuffle", 2012. It works for
    any length, without rejection.
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
    """A number in a fine stratum of a cell."""
    position = np.float64(cell) * np.float64(fine_count) + np.float64(fine) + np.float64(jitter)
    part = position / (np.float64(cell_count) * np.float64(fine_count))
    return np.float32(floor(part * _STEPS)) * _STEP  # rounded down: never up to 1


@device
def _pair(seed, pixel, sample, pair, sample_count):
    # Samples beyond the count begin another set, independent of this one as another pixel's is.
    count = np.uint32(sample_count)
    number = np.uint32(sample)
    own = np.uint32(number % count)
    key = mix(stream_key(seed, pixel, pair) ^ mix(np.uint32(number // count)))

    columns = np.uint32(square_root(np.float64(count)))
    rows = np.uint32(np.uint32(count + columns - _1) // columns)
    cell = _shuffled(own, np.uint32(columns * rows), np.uint32(key ^ _OF_CELL))
    column, row = np.uint32(cell % columns), np.uint32(cell // columns)
    # Each column and each row has its own permutation. With one for all columns and one for all
    # rows, as in Kensler's, errors of smooth functions fall with N**-0.75, not N**-1.
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
        0 to 2**32 - 1. The number depends only on them and on the count.
    sample_count : int
        1 to 2**24. Samples beyond it begin another set.

    Returns
    -------
    float32
        In [0, 1). If floor(sqrt(sample_count)) divides the count, each interval of length
        1 / sample_count has one of a set's numbers; if not, strata are slightly finer, and some
        stay empty.

    References
    ----------
    .. [1] Chiu, Shirley and Wang, "Multi-Jittered Sampling", Graphics Gems IV, 1994.
    .. [2] Kensler, "Correlated Multi-Jittered Sampling", Pixar Technical Memo 13-01, 2013: the
       permutation as a function of its key, and counts that fill no grid.
    """
    dimension = np.uint32(dimension)
    x, y = _pair(seed, pixel, sample, dimension >> _1, sample_count)
    return y if dimension & _1 else x


@device
def sample_pair(seed, pixel, sample, dimension, sample_count):
    """The numbers of an even dimension and the next, two float32; see `sample_number`."""
    return _pair(seed, pixel, sample, np.uint32(dimension) >> _1, sample_count)
