"""Tallies: what rays met on their way, counted while they are traced.

A ray's tally is a row of counts, and kernels take its address, or None for a ray that nobody
counts: code for None is left out when a kernel is compiled, so that not counting costs nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device
from raystream.jit.simd import address, load, store

__all__ = [
    "BACKTRACKS",
    "BACKTRACK_STEPS",
    "COLUMNS",
    "LEAVES",
    "RESTARTS",
    "ROW",
    "SHADINGS",
    "STEPS",
    "TESTS",
    "add_to",
    "new_tallies",
    "tally_of",
]

#: What is counted, in the order of a row: see `machines.counters.RayCounters`.
COLUMNS = ("steps", "leaves", "tests", "restarts", "backtracks", "backtrack_steps", "shadings")

#: Where in a row the counts are, in bytes.
STEPS, LEAVES, TESTS, RESTARTS, BACKTRACKS, BACKTRACK_STEPS, SHADINGS = (
    np.uint64(4 * k) for k in range(len(COLUMNS))
)

#: Bytes of a row, a power of two.
ROW = np.uint64(32)


def new_tallies(count: int) -> NDArray[np.uint32]:
    """Tallies of zero for rays, of shape (count, 8); the last column is not used."""
    return np.zeros((count, int(ROW) // 4), np.uint32)


@device
def tally_of(tallies, i):
    """The tally of ray i: its address; or None if `tallies` is None."""
    if tallies is not None:
        return address(tallies) + np.uint64(i) * ROW
    return None


@device
def add_to(tally, column, more):
    """Add to a count of a ray, unless its tally is None."""
    if tally is not None:
        at = tally + column
        # A sum of two uint32 is a uint64.
        store(at, np.uint32(load(np.uint32, at) + np.uint32(more)))
