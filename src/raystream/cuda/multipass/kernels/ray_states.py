"""Device functions of a pass around a ray's step: which ray, whether it waits, its new state."""

from __future__ import annotations

import numpy as np

from raystream.cuda.multipass.control import CHOSEN, COUNTS, STATES
from raystream.jit.atomics import atomic_add_aggregated
from raystream.jit.constants import NULL, SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import load

__all__ = ["chosen_kernel", "is_waiting", "move", "row_of"]

_MORE, _LESS = np.uint32(1), np.uint32(2**32 - 1)


@device
def row_of(rows, i):
    """Number of the ray of thread i."""
    if rows == NULL:
        return i
    return np.uint64(load(np.uint32, rows + (i << SHIFT_32)))


@device
def chosen_kernel(control):
    """Number of the kernel that runs."""
    return load(np.uint32, control + CHOSEN)


@device
def is_waiting(control, chosen, now):
    """Whether a ray in this state waits for the kernel."""
    return load(np.uint32, control + STATES + (np.uint64(chosen) << SHIFT_32)) == np.uint32(now)


@device
def move(control, now, then):
    """Update the counts for a ray that changes from one state to another."""
    if then != now:
        atomic_add_aggregated(control + COUNTS + (np.uint64(now) << SHIFT_32), _LESS)
        atomic_add_aggregated(control + COUNTS + (np.uint64(then) << SHIFT_32), _MORE)
