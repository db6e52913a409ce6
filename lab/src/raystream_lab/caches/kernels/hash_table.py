"""The hash function of the tables of lines."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device

#: Minimum capacity of a table.
MIN_CAPACITY = 8

#: 2**64 divided by the golden ratio, odd: Knuth, The Art of Computer Programming 3, 6.4.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)

# Neighbouring lines stay together, since they are often accessed together.
_GROUP = np.uint64(2)  # log2 of 4 lines
_IN_GROUP = np.uint64(3)


def home_shift(capacity: int) -> np.uint64:
    """The shift of `home_of` for a table's capacity, a power of two."""
    return np.uint64(64 - (capacity.bit_length() - 1) + int(_GROUP))


@device
def home_of(key, shift):
    """The first entry to probe for a key."""
    group = ((key >> _GROUP) * _GOLDEN) >> shift
    return (group << _GROUP) | (key & _IN_GROUP)
