"""Tallies: counts of the steps, tests and other events of each ray.

Kernels take the address of a ray's row of counts, or None for no counting: code for None is left
out when a kernel is compiled, so not counting costs nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device
from raystream.jit.simd import load, store

#: The counts of a row in order: see `machines.counters.RayCounters`.
COLUMNS = (
    "steps",
    "leaves",
    "tests",
    "restarts",
    "backtracks",
    "backtrack_steps",
    "shadings",
    "link_nodes",
)

#: Byte offsets of the counts in a row.
STEPS, LEAVES, TESTS, RESTARTS, BACKTRACKS, BACKTRACK_STEPS, SHADINGS, LINK_NODES = (
    np.uint64(4 * k) for k in range(len(COLUMNS))
)

#: Bytes of a row, a power of two.
ROW = np.uint64(32)


def new_tallies(count: int) -> NDArray[np.uint32]:
    """Zeroed tallies for rays, of shape (count, 8)."""
    return np.zeros((count, int(ROW) // 4), np.uint32)


@device
def tally_of(tallies, i):
    """The tally of ray i, from the address of the first ray's; None if that is None."""
    if tallies is None:
        return None
    return tallies + i * ROW


@device
def add_to(tally, column, more):
    """Add to a count of a ray, unless its tally is None."""
    if tally is not None:
        at = tally + column
        # A sum of two uint32 is a uint64.
        store(at, np.uint32(load(np.uint32, at) + np.uint32(more)))
