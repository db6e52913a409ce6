"""Marks on a time line: bits, and how many of them each block and each row of blocks has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.intrinsics import bits_above, sum_above
from raystream.jit.simd import load, popcount, store

__all__ = [
    "BITS",
    "BLOCK_WORDS",
    "ROW_BLOCKS",
    "Marks",
    "mark",
    "marks_after",
    "marks_before",
    "unmark",
]

#: Bits of a word; words of a block; blocks of a row.
BITS = BLOCK_WORDS = ROW_BLOCKS = 64

_ZERO = np.uint64(0)
_ONE = np.uint64(1)
_LAST = np.uint64(63)
_NUMBER = np.uint64(3)  # eight bytes, as a shift
# From a time to its word, block and row, as shifts.
_WORD, _BLOCK, _ROW = (np.uint64(k) for k in (6, 12, 18))
_NEAR = np.uint64(4)  # words that are looked at one by one


class Marks(NamedTuple):
    """Marks; all are addresses of uint64.

    Attributes
    ----------
    words
        64 marks each, the earliest in the lowest bit.
    blocks
        Marks of 64 words each.
    rows
        Marks of 64 blocks each.
    """

    words: np.uint64
    blocks: np.uint64
    rows: np.uint64


@device
def _add(numbers, i, more):
    at = numbers + (i << _NUMBER)
    store(at, load(np.uint64, at) + more)


@device
def mark(marks, time):
    """Set the mark at a time that has none."""
    _add(marks.words, time >> _WORD, _ONE << (time & _LAST))
    _add(marks.blocks, time >> _BLOCK, _ONE)
    _add(marks.rows, time >> _ROW, _ONE)


@device
def unmark(marks, time):
    """Remove the mark at a time that has one."""
    _add(marks.words, time >> _WORD, _ZERO - (_ONE << (time & _LAST)))
    _add(marks.blocks, time >> _BLOCK, _ZERO - _ONE)
    _add(marks.rows, time >> _ROW, _ZERO - _ONE)


@device
def _part(numbers, i):
    """Address of the 64 numbers among which number i is."""
    return numbers + ((i & ~_LAST) << _NUMBER)


@device
def marks_before(word, time):
    """How many marks of a time's word are before it."""
    return popcount(word & ((_ONE << (time & _LAST)) - _ONE))


@device
def marks_after(marks, time, now):
    """How many marks are after a time that has one, given that none is after `now`.

    The nearest are counted by their bits, so that they cost little; what is far is counted by
    the block or by the row.
    """
    word, last_word = time >> _WORD, now >> _WORD
    count = popcount(load(np.uint64, marks.words + (word << _NUMBER)) >> (time & _LAST)) - _ONE
    if last_word - word <= _NEAR:
        while word < last_word:
            word += _ONE
            count += popcount(load(np.uint64, marks.words + (word << _NUMBER)))
        return count
    count += bits_above(_part(marks.words, word), word & _LAST)
    block, last_block = time >> _BLOCK, now >> _BLOCK
    if block != last_block:
        count += sum_above(_part(marks.blocks, block), block & _LAST)
        row, last_row = time >> _ROW, now >> _ROW
        while row < last_row:
            row += _ONE
            count += load(np.uint64, marks.rows + (row << _NUMBER))
    return count
