"""Replay passes: rays wait in buckets by the pass in which they leave their kernel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device, kernel

#: The rules of `machines.schedulers`, and a kernel chosen by the caller.
NAIVE, THRESHOLD, MOST_WORK, DOUBLE, CHOSEN = range(5)

#: No ray.
END = np.uint32(2**32 - 1)


class QueueState(NamedTuple):
    """Rays that wait for K kernels; rays with equal walks are one.

    Attributes
    ----------
    waiting : ndarray of shape (K,), int64
        Number of rays that wait for each.
    clocks : ndarray of shape (K,), uint64
        Number of passes that each has run.
    offsets, masks : ndarray of shape (K,), uint64
        The buckets of kernel k begin at offsets[k]; a ray that leaves in its pass c is in bucket
        ``c & masks[k]``. There are more buckets than passes of the longest run.
    heads : ndarray of shape (B,), uint32
        The first ray in each bucket, or `END`.
    links : ndarray of shape (N,), uint32
        The next ray in the same bucket.
    cursors : ndarray of shape (N,), int64
        The run after each ray's current run.
    latest : ndarray of shape (1,), int64
        The kernel that ran last; -1 before the first pass.
    leaving : ndarray of shape (1,), uint32
        First of the rays whose run has ended.
    """

    waiting: NDArray[np.int64]
    clocks: NDArray[np.uint64]
    offsets: NDArray[np.uint64]
    masks: NDArray[np.uint64]
    heads: NDArray[np.uint32]
    links: NDArray[np.uint32]
    cursors: NDArray[np.int64]
    latest: NDArray[np.int64]
    leaving: NDArray[np.uint32]


@device
def _fullest(waiting, is_tests, tests_too, end):
    """The first kernel before `end` with the most rays; -1 if no ray waits."""
    best = -1
    for k in range(end):
        is_candidate = waiting[k] and (tests_too or not is_tests[k])
        if is_candidate and (best < 0 or waiting[k] > waiting[best]):
            best = k
    return best


@device
def _first_test(waiting, is_tests):
    for k in range(len(waiting) - 1):
        if waiting[k] and is_tests[k]:
            return k
    return -1


@device
def _choose(rule, share, waiting, is_tests, latest):
    """Choose the next kernel; see the classes of `machines.schedulers`."""
    shading = len(waiting) - 1
    if rule in (MOST_WORK, DOUBLE):
        best = _fullest(waiting, is_tests, True, shading + 1)
        stays = rule == DOUBLE and latest >= 0 and not waiting[best] > 2 * waiting[latest]
        return latest if stays else best
    test = _first_test(waiting, is_tests)
    if rule == NAIVE:
        if test >= 0:
            return test
        for k in range(shading - 1, -1, -1):
            if waiting[k]:
                return k
        return shading
    other = _fullest(waiting, is_tests, False, shading)
    active = 0
    for k in range(shading):
        active += waiting[k]
    if test >= 0 and (other < 0 or waiting[test] >= share * active):
        return test
    return other if other >= 0 else shading


@kernel
def run_passes(walks, at_once, is_tests, rule, share, chosen, queued, out):
    """Run passes until no ray is active or the output is full.

    Parameters
    ----------
    walks : DistinctWalks
    at_once : ndarray of shape (K,), uint32
        Maximum steps of each kernel per pass.
    is_tests : ndarray of shape (K,), bool
        Whether each kernel intersects.
    rule : int
    share : float
        For `THRESHOLD`.
    chosen : int
        For `CHOSEN`.
    queued : QueueState
        Updated.
    out : tuple of two ndarray of shape (P,), uint8 and uint32
        Kernel and number of rays of each pass.

    Returns
    -------
    int
        Number of passes run.
    """
    waiting, clocks, heads, links = queued.waiting, queued.clocks, queued.heads, queued.links
    splits, walk_kernels, lengths, weights = walks
    kernels, counts = out
    latest, leaving = queued.latest[0], queued.leaving[0]
    pass_count = 0
    while True:
        # Step 1: move rays that leave a kernel to their next run.
        while leaving != END:
            ray = np.uint64(leaving)
            leaving = links[ray]
            if latest >= 0:
                waiting[latest] -= np.int64(weights[ray])
            run = np.uint64(queued.cursors[ray])
            if run < np.uint64(splits[ray + ONE_U64]):
                k = np.uint64(walk_kernels[run])
                span = np.uint64(at_once[k])
                passes = (np.uint64(lengths[run]) + span - ONE_U64) // span
                bucket = queued.offsets[k] + ((clocks[k] + passes) & queued.masks[k])
                links[ray] = heads[bucket]
                heads[bucket] = np.uint32(ray)
                waiting[k] += np.int64(weights[ray])
                queued.cursors[ray] = run + ONE_U64
        # Step 2: run a pass.
        is_over = True
        for k in range(len(waiting)):
            is_over = is_over and waiting[k] == 0
        if is_over or pass_count == len(kernels):
            break
        latest = chosen
        if rule != CHOSEN:
            latest = _choose(rule, share, waiting, is_tests, queued.latest[0])
        queued.latest[0] = latest
        kernels[pass_count] = latest
        counts[pass_count] = waiting[latest]
        pass_count += 1
        clocks[latest] += ONE_U64
        bucket = queued.offsets[latest] + (clocks[latest] & queued.masks[latest])
        leaving = heads[bucket]
        heads[bucket] = END
    queued.leaving[0] = leaving
    return pass_count
