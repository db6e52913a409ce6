"""Counts of rays on the device: where each ray's rows begin, and whether a value is among them."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.cuda import DeviceArray, RangeKernel, StreamScope
from raystream.jit.cuda.scan import Scan
from raystream.jit.simd import load, store

__all__ = ["NOTE", "add_up", "is_any"]

_LONG = np.uint64(3)  # a number's eight bytes, as a shift


@kernel
def _note(i, counts, wanted, noted):
    if load(np.int64, counts + (i << _LONG)) == wanted:
        store(noted, np.int64(1))


#: Note that a value is there.
NOTE = RangeKernel(_note)


def add_up(work: StreamScope, counts: DeviceArray, splits: DeviceArray) -> None:
    """Write the sums of the first 0, 1, ... N numbers.

    Parameters
    ----------
    work : StreamScope
    counts : DeviceArray of shape (N,), int64
    splits : DeviceArray of shape (N + 1,), int64
        Written.
    """
    count = len(counts)
    if count == 0:
        work.follow()
        work.gpu.clear(splits, work.stream)
        return
    scan = Scan(work.gpu, count, empty=work.empty)
    work.follow()
    scan.run(counts.address, count, splits.address, np.int64, work.stream.native)


def is_any(work: StreamScope, counts: DeviceArray, value: int) -> bool:
    """Whether a value is among int64 numbers; this waits for the device."""
    noted = work.cleared("note", 1, np.int64)
    work.launch(NOTE, counts.size, (counts.address, np.int64(value), noted.address))
    return bool(work.read(noted)[0])
