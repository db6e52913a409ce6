"""Where in a hash table lines are looked for."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device

__all__ = ["MIN_CAPACITY", "home_of", "home_shift"]

#: Places that a table has at least.
MIN_CAPACITY = 8

#: 2**64 divided by the golden ratio, odd: Knuth, The Art of Computer Programming 3, 6.4.
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)

# Neighbours stay together, since they are often needed together.
_GROUP = np.uint64(2)  # four lines, as a shift
_IN_GROUP = np.uint64(3)


def home_shift(capacity: int) -> np.uint64:
    """What `home_of` needs to know of a table's capacity, a power of two."""
    return np.uint64(64 - (capacity.bit_length() - 1) + int(_GROUP))


@device
def home_of(key, shift):
    """Number of the place from which on a key is looked for."""
    group = ((key >> _GROUP) * _GOLDEN) >> shift
    return (group << _GROUP) | (key & _IN_GROUP)
