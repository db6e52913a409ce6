"""Running sums of counts on the device, where each ray's rows begin; and a look for a value."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import kernel
from raystream.jit.cuda import DeviceArray, RangeKernel, Work
from raystream.jit.simd import load, store

__all__ = ["NOTE", "SPREAD", "SUM_CHUNKS", "add_up", "is_any"]

#: Numbers that a thread adds.
CHUNK = 256

_CHUNK = np.uint64(CHUNK)
_LONG = np.uint64(3)  # a number's eight bytes, as a shift


@kernel
def _sum_chunks(i, counts, length, sums):
    total = np.int64(0)
    for k in range(i * _CHUNK, min((i + np.uint64(1)) * _CHUNK, length)):
        total += load(np.int64, counts + (k << _LONG))
    store(sums + (i << _LONG), total)


@kernel
def _spread(i, counts, length, starts, splits):
    total = load(np.int64, starts + (i << _LONG))
    end = min((i + np.uint64(1)) * _CHUNK, length)
    for k in range(i * _CHUNK, end):
        store(splits + (k << _LONG), total)
        total += load(np.int64, counts + (k << _LONG))
    if end == length:
        store(splits + (length << _LONG), total)


@kernel
def _note(i, counts, wanted, noted):
    if load(np.int64, counts + (i << _LONG)) == wanted:
        store(noted, np.int64(1))


#: Add the numbers of a chunk; write a chunk's running sums; note that a value is there.
SUM_CHUNKS, SPREAD, NOTE = RangeKernel(_sum_chunks), RangeKernel(_spread), RangeKernel(_note)


def add_up(work: Work, counts: DeviceArray, splits: DeviceArray) -> None:
    """Write the sums of the first 0, 1, ... N numbers.

    Parameters
    ----------
    work : Work
    counts : DeviceArray of shape (N,), int64
    splits : DeviceArray of shape (N + 1,), int64
        Written.

    Notes
    -----
    Chunks are summed, the sums are summed up in the same way, and each chunk goes on from there:
    a thread reads what lies together, so it is right, and far from as fast as memory.
    """
    length = np.uint64(len(counts))
    chunk_count = -(-len(counts) // CHUNK)
    starts = work.cleared("sums", max(chunk_count, 1) + 1, np.int64)
    if chunk_count > 1:
        sums = work.empty("sums", chunk_count, np.int64)
        work.launch(SUM_CHUNKS, chunk_count, (counts.address, length, sums.address))
        add_up(work, sums, starts)
    work.launch(
        SPREAD, max(chunk_count, 1), (counts.address, length, starts.address, splits.address)
    )


def is_any(work: Work, counts: DeviceArray, value: int) -> bool:
    """Whether a value is among int64 numbers; this waits for the device."""
    noted = work.cleared("note", 1, np.int64)
    work.launch(NOTE, counts.size, (counts.address, np.int64(value), noted.address))
    return bool(work.read(noted)[0])
