"""Schedulers on the device, on one thread: the choice of the next kernel, as `machines.schedulers`.

With compaction also the rest of `machines.ray_streams.RayStreams.schedule`.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.multipass.control import (
    CHOSEN,
    COUNTS,
    DROPPING,
    LATEST,
    LAUNCHED,
    LENGTH,
    LOG,
    LOG_BYTES,
    MOST_PASSES,
    NO_KERNEL,
    PASS_COUNT,
    STATES,
    UNTIL,
)
from raystream.jit.constants import ONE_U32, ONE_U64, SHIFT_32, ZERO_U32
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel, set_condition
from raystream.jit.simd import load, store
from raystream.machines.records import RayState
from raystream.machines.schedulers import SCHEDULERS

__all__ = ["DECIDE", "DECIDE_IN_LOOP", "decide"]

_MOST = np.uint64(MOST_PASSES)
_DONE_COUNT = COUNTS + np.uint64(4 * RayState.DONE)

_NAIVE, _THRESHOLD, _MOST_WORK = (
    np.uint64(SCHEDULERS.index(name)) for name in ("naive", "threshold", "most-work")
)


@device
def _waiting(control, k):
    """Number of rays that wait for kernel k."""
    state = np.uint64(load(np.uint32, control + STATES + (k << SHIFT_32)))
    return np.uint64(load(np.uint32, control + COUNTS + (state << SHIFT_32)))


@device
def _is_test(rules, k):
    return (rules.tests >> k) & ONE_U64 == ONE_U64


@device
def _run(control, k):
    """Select kernel k, and log the pass."""
    store(control + CHOSEN, np.uint32(k))
    count = np.uint64(load(np.uint32, control + PASS_COUNT))
    at = control + LOG + (count % _MOST) * LOG_BYTES
    store(at, np.uint32(k))
    store(at + np.uint64(4), np.uint32(_waiting(control, k)))
    store(at + np.uint64(8), load(np.uint32, control + LENGTH))
    store(control + PASS_COUNT, np.uint32(count + ONE_U64))


@device
def _drop_ended(control):
    """Remove the rays that have ended from the counts."""
    length = np.uint64(load(np.uint32, control + LENGTH))
    ended = np.uint64(load(np.uint32, control + _DONE_COUNT))
    store(control + LENGTH, np.uint32(length - ended))
    store(control + _DONE_COUNT, ZERO_U32)
    store(control + DROPPING, ZERO_U32)


@device
def _choose(control, rules, active):
    """The number of a kernel for which some ray waits; see `machines.schedulers`."""
    count = rules.kernel_count
    shading = count - ONE_U64
    # The first that intersects, the last and the fullest of the others, and the fullest of all.
    test = last_other = fullest_other = count
    fullest, most, most_other = np.uint64(0), np.uint64(0), np.uint64(0)
    for k in range(count):
        waiting = _waiting(control, k)
        if waiting > most:
            fullest, most = k, waiting
        if waiting == np.uint64(0) or k == shading:
            continue
        if _is_test(rules, k):
            if test == count:
                test = k
            continue
        last_other = k
        if waiting > most_other:
            fullest_other, most_other = k, waiting
    if rules.scheduler == _MOST_WORK:
        return fullest
    if rules.scheduler == _NAIVE:
        if test != count:
            return test
        return last_other if last_other != count else shading
    if rules.scheduler == _THRESHOLD:
        if test != count and (
            last_other == count
            or np.float64(_waiting(control, test)) >= rules.share * np.float64(active)
        ):
            return test
        return fullest_other if last_other != count else shading
    # "double"
    latest = load(np.uint32, control + LATEST)
    if latest == NO_KERNEL or most > np.uint64(2) * _waiting(control, np.uint64(latest)):
        return fullest
    return np.uint64(latest)


@device
def _decide(control, rules):
    """Choose the kernel of the next pass, or none if no ray is active."""
    store(control + CHOSEN, NO_KERNEL)
    shading = rules.kernel_count - ONE_U64
    searching, ended = np.uint64(0), _waiting(control, shading)
    for k in range(shading):
        searching += _waiting(control, k)
    if searching + ended == np.uint64(0):
        return
    if rules.compacts:
        if load(np.uint32, control + DROPPING) != ZERO_U32:
            _drop_ended(control)
        elif searching + searching <= np.uint64(load(np.uint32, control + LENGTH)):
            if ended != np.uint64(0):
                store(control + DROPPING, ONE_U32)
                _run(control, shading)
                return
            _drop_ended(control)
    chosen = _choose(control, rules, searching)
    store(control + LATEST, np.uint32(chosen))
    _run(control, chosen)


@kernel
def decide(i, control, rules):  # noqa: ARG001 (there is one)
    """Choose the kernel of the next pass, on one thread."""
    _decide(control, rules)


@device
def _returns_to_host(control, rules):
    """Whether the host must continue: at its limit of passes, or to compact the streams."""
    if load(np.uint32, control + PASS_COUNT) >= load(np.uint32, control + UNTIL):
        return True
    active = np.uint64(0)
    for k in range(rules.kernel_count):
        active += _waiting(control, k)
    return rules.compacts and active + active <= np.uint64(load(np.uint32, control + LAUNCHED))


@kernel
def decide_in_loop(i, control, rules, condition):  # noqa: ARG001 (there is one)
    """Choose the kernel of the next pass, and whether the loop runs another one after it."""
    _decide(control, rules)
    is_over = load(np.uint32, control + CHOSEN) == NO_KERNEL or _returns_to_host(control, rules)
    set_condition(condition, ZERO_U32 if is_over else ONE_U32)


#: These run on one thread, before each pass.
DECIDE, DECIDE_IN_LOOP = RangeKernel(decide), RangeKernel(decide_in_loop)
