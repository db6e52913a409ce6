"""Deduplication of walks: many rays of an image take the same steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.memory import check_memory
from raystream_lab.walks.kernels.find_distinct import FREE, find_distinct


class DistinctWalks(NamedTuple):
    """The distinct walks.

    Attributes
    ----------
    run_splits : ndarray of shape (D + 1,), int64
        Walk i has runs run_splits[i] to run_splits[i + 1].
    run_kernels : ndarray of shape (M,), uint8
    run_lengths : ndarray of shape (M,), uint32
    weights : ndarray of shape (D,), uint32
        Number of rays that take each walk.
    """

    run_splits: NDArray[np.int64]
    run_kernels: NDArray[np.uint8]
    run_lengths: NDArray[np.uint32]
    weights: NDArray[np.uint32]


def distinct_walks(
    run_splits: NDArray[np.int64],
    run_kernels: NDArray[np.uint8],
    run_lengths: NDArray[np.uint32],
) -> DistinctWalks:
    """Find the distinct walks among the runs of N rays, exactly; see `Walks`.

    Raises
    ------
    MemoryError
        If they do not fit into the free memory.
    """
    count = len(run_splits) - 1
    if count >= FREE:
        raise ValueError(f"walks: expected fewer than {int(FREE):,} rays, got {count:,}")
    place_count = 2 << count.bit_length()
    check_memory(4 * place_count + 8 * count, f"a table of {count:,} walks would")
    table = np.full(place_count, FREE, np.uint32)
    firsts, weights = np.empty(count, np.uint32), np.empty(count, np.uint32)
    found = find_distinct(run_splits, run_kernels, run_lengths, table, firsts, weights)
    firsts = firsts[:found]
    lengths = np.diff(run_splits)[firsts]
    splits = np.zeros(found + 1, np.int64)
    np.cumsum(lengths, out=splits[1:])
    total = int(splits[-1])
    check_memory(21 * total, f"{total:,} runs of distinct walks would", "replay fewer rays")
    rows = np.repeat(run_splits[firsts] - splits[:-1], lengths) + np.arange(total)
    return DistinctWalks(splits, run_kernels[rows], run_lengths[rows], weights[:found].copy())
