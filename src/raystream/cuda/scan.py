"""Counts of rays on the device: their prefix sums, and whether a value is among them."""

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


#: Sets a flag if a number has a value.
NOTE = RangeKernel(_note)


def prefix_sum(scope: StreamScope, counts: DeviceArray) -> DeviceArray:
    """Sums of the first 0, 1, ... N numbers.

    Parameters
    ----------
    scope : StreamScope
    counts : DeviceArray of shape (N,), int64

    Returns
    -------
    DeviceArray of shape (N + 1,), int64
    """
    count = len(counts)
    splits = scope.ready("splits", count + 1, np.int64)
    if count == 0:
        scope.gpu.clear(splits, scope.stream)
        return splits
    with scope.nested() as inner:
        scan = Scan(scope.gpu, count, empty=inner.ready)
        scan.run(counts.address, count, splits.address, np.int64, scope.stream.native)
    return splits


def note_value(scope: StreamScope, counts: DeviceArray, value: int) -> DeviceArray:
    """Set an int64 to 1 if a value is among int64 numbers, else to 0."""
    noted = scope.cleared("note", 1, np.int64)
    scope.launch(NOTE, counts.size, (counts.address, np.int64(value), noted.address))
    return noted
