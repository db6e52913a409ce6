"""A bitmap with counts per block and per row of blocks, for fast ranks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.intrinsics import bits_above, sum_above
from raystream.jit.simd import load, popcount, store

#: Bits per word, words per block, blocks per row.
BITS = BLOCK_WORDS = ROW_BLOCKS = 64

_LAST = np.uint64(63)
# Shifts from a time to its word, block and row.
_WORD, _BLOCK, _ROW = (np.uint64(k) for k in (6, 12, 18))
_NEAR = np.uint64(4)  # words that are counted one by one


class RankedBits(NamedTuple):
    """A bitmap over times; all are addresses of uint64.

    Attributes
    ----------
    words
        64 bits each, the earliest in the lowest bit.
    blocks
        Bits set in 64 words each.
    rows
        Bits set in 64 blocks each.
    """

    words: np.uint64
    blocks: np.uint64
    rows: np.uint64


@device
def _add(numbers, i, more):
    at = numbers + (i << SHIFT_64)
    store(at, load(np.uint64, at) + more)


@device
def set_bit(bits, time):
    """Set the bit of a time that is clear."""
    _add(bits.words, time >> _WORD, ONE_U64 << (time & _LAST))
    _add(bits.blocks, time >> _BLOCK, ONE_U64)
    _add(bits.rows, time >> _ROW, ONE_U64)


@device
def clear_bit(bits, time):
    """Clear the bit of a time that is set."""
    _add(bits.words, time >> _WORD, ZERO_U64 - (ONE_U64 << (time & _LAST)))
    _add(bits.blocks, time >> _BLOCK, ZERO_U64 - ONE_U64)
    _add(bits.rows, time >> _ROW, ZERO_U64 - ONE_U64)


@device
def _part(numbers, i):
    """Address of the group of 64 numbers that contains number i."""
    return numbers + ((i & ~_LAST) << SHIFT_64)


@device
def count_before(word, time):
    """Count the bits set before a time in its word."""
    return popcount(word & ((ONE_U64 << (time & _LAST)) - ONE_U64))


@device
def count_after(bits, time, now):
    """Count the bits set after a time whose bit is set, given that none is set after `now`.

    Near bits are counted per word, distant ones per block or row.
    """
    word, last_word = time >> _WORD, now >> _WORD
    count = popcount(load(np.uint64, bits.words + (word << SHIFT_64)) >> (time & _LAST)) - ONE_U64
    if last_word - word <= _NEAR:
        while word < last_word:
            word += ONE_U64
            count += popcount(load(np.uint64, bits.words + (word << SHIFT_64)))
        return count
    count += bits_above(_part(bits.words, word), word & _LAST)
    block, last_block = time >> _BLOCK, now >> _BLOCK
    if block != last_block:
        count += sum_above(_part(bits.blocks, block), block & _LAST)
        row, last_row = time >> _ROW, now >> _ROW
        while row < last_row:
            row += ONE_U64
            count += load(np.uint64, bits.rows + (row << SHIFT_64))
    return count
