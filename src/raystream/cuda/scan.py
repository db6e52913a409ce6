"""Counts of rays on the device: where each ray's rows begin, and whether a value is among them."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.cuda import DeviceArray, RangeKernel, StreamScope
from raystream.jit.cuda.scan import Scan
from raystream.jit.simd import load, store

__all__ = ["NOTE", "note_value", "prefix_sum"]

_LONG = np.uint64(3)  # a number's eight bytes, as a shift


@kernel
def _note(i, counts, wanted, noted):
    if load(np.int64, counts + (i << _LONG)) == wanted:
        store(noted, np.int64(1))


#: Note that a value is there.
NOTE = RangeKernel(_note)


def prefix_sum(work: StreamScope, counts: DeviceArray) -> DeviceArray:
    """Sum the first 0, 1, ... N numbers.

    Parameters
    ----------
    work : StreamScope
    counts : DeviceArray of shape (N,), int64

    Returns
    -------
    DeviceArray of shape (N + 1,), int64
    """
    count = len(counts)
    splits = work.ready("splits", count + 1, np.int64)
    if count == 0:
        work.gpu.clear(splits, work.stream)
        return splits
    with work.nested() as scope:
        scan = Scan(work.gpu, count, empty=scope.ready)
        scan.run(counts.address, count, splits.address, np.int64, work.stream.native)
    return splits


def note_value(work: StreamScope, counts: DeviceArray, value: int) -> DeviceArray:
    """Set an int64 to 1 if a value is among int64 numbers, else to 0."""
    noted = work.cleared("note", 1, np.int64)
    work.launch(NOTE, counts.size, (counts.address, np.int64(value), noted.address))
    return noted
