"""Count a ray's repeated triangle tests."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import kernel

_EMPTY = np.int32(-1)


@kernel
def count_repeats(begin, end, walks, lists, roles, stamps, boxes, counts):
    """Count the tests of the rays begin to end, and the repeated ones.

    Parameters
    ----------
    walks : tuple of ndarray
        ``run_splits``, ``run_kernels``, ``run_lengths``, ``visit_splits``, ``visits`` of `Walks`.
    lists : GridArrays
    roles : ndarray of shape (K,), uint8
        See `emit_references`: 1 visits a cell, 2 tests per triangle.
    stamps : ndarray of shape (F,), int64
        Initially -1; the last ray that tested each triangle is written.
    boxes : tuple of ndarray, int32
        Mailboxes of a ray; their sizes are powers of two.
    counts : ndarray of shape (2 + B,), int64
        Added to: tests, tests repeated by the same ray, and hits in each mailbox.
    """
    run_splits, run_kernels, run_lengths, visit_splits, visits = walks
    splits, references = lists.splits, lists.references
    for i in range(np.uint64(begin), np.uint64(end)):
        for box in boxes:
            box[:] = _EMPTY
        visit, cell = np.uint64(visit_splits[i]), np.uint64(0)
        for run in range(np.uint64(run_splits[i]), np.uint64(run_splits[i + ONE_U64])):
            role, length = roles[np.uint64(run_kernels[run])], np.uint64(run_lengths[run])
            if role == 1:
                visit += length
                cell = np.uint64(visits[visit - ONE_U64])
            if role != 2:
                continue
            counts[0] += np.int64(length)
            first = np.uint64(splits[cell])
            for row in range(first, first + length):
                triangle = np.uint64(references[row])
                if stamps[triangle] == np.int64(i):
                    counts[1] += 1
                stamps[triangle] = np.int64(i)
                for k in range(len(boxes)):
                    box = boxes[k]
                    place = triangle & (np.uint64(len(box)) - ONE_U64)
                    if box[place] == np.int32(triangle):
                        counts[2 + k] += 1
                    box[place] = np.int32(triangle)
