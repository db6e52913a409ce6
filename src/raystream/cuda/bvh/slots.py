"""Assignment of children to the eight slots of a node, so that rays visit the nearest first.

A child should be in the slot of the octant where it lies as seen from the node's centre: its gain
is the sum over the axes of its centre's offset, negated where the slot is on the low side. The
greatest sum of gains is found exactly, by dynamic programming over the sets of slots that the first
children take: 8 x 128 steps per node.

Source: Ylitie, Karras, Laine 2017, section 3.1, who use an auction.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.entries import HIGH, LINK, LOW
from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device, kernel
from raystream.structures.bvh.layout import WIDTH

__all__ = ["assign_slots"]

_SETS = 1 << WIDTH


@device
def _write_gains(entries, row, count, gains):
    """Gain of each child in each slot."""
    middle = np.zeros(3, np.float64)
    for axis in range(np.uint64(3)):
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for child in range(count):
            low = min(low, entries[row, child, np.uint64(LOW) + axis])
            high = max(high, entries[row, child, np.uint64(HIGH) + axis])
        middle[axis] = np.float64(low) + np.float64(high)
    for child in range(count):
        for slot in range(np.uint64(WIDTH)):
            gain = 0.0
            for axis in range(np.uint64(3)):
                low = np.float64(entries[row, child, np.uint64(LOW) + axis])
                offset = low + entries[row, child, np.uint64(HIGH) + axis] - middle[axis]
                gain += offset if (slot >> axis) & ONE_U64 else -offset
            gains[child, slot] = gain


@kernel
def assign_slots(begin, end, entries, words):
    """Move the entries of some wide nodes to their slots.

    Parameters
    ----------
    begin, end : int
    entries : ndarray of shape (M, 8, 8), float32
        See `entries.list_entries`; changed: the link of an empty slot is 0.
    words : ndarray
        The same as int32.
    """
    gains = np.empty((WIDTH, WIDTH), np.float64)
    best = np.empty(_SETS, np.float64)
    last = np.empty(_SETS, np.uint64)  # the slot of the set's last child
    own = np.empty((WIDTH, 8), np.int32)
    for row in range(np.uint64(begin), np.uint64(end)):
        count = np.uint64(0)
        while count < np.uint64(WIDTH) and words[row, count, LINK] != 0:
            count += ONE_U64
        if count == np.uint64(0):
            continue
        _write_gains(entries, row, count, gains)
        best[:] = -np.inf
        best[0] = 0.0
        greatest = np.uint64(0)
        for taken in range(np.uint64(_SETS)):
            child = np.uint64(0)
            for slot in range(np.uint64(WIDTH)):
                child += (taken >> slot) & ONE_U64
            if child == count:
                if greatest == np.uint64(0) or best[taken] > best[greatest]:
                    greatest = taken
            elif child < count:
                for slot in range(np.uint64(WIDTH)):
                    more = taken | (ONE_U64 << slot)
                    if more != taken and best[taken] + gains[child, slot] > best[more]:
                        best[more] = best[taken] + gains[child, slot]
                        last[more] = slot
        own[:] = words[row]
        words[row] = 0
        child = count
        while child != np.uint64(0):
            child -= ONE_U64
            slot = last[greatest]
            greatest ^= ONE_U64 << slot
            words[row, slot] = own[child]
