"""Timing of calls, several of them in turn."""

from __future__ import annotations

import gc
import math
import statistics
import time
from collections.abc import Callable, Mapping

Call = Callable[[], object]


def seconds_of(call: Call) -> float:
    """Time one call."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def repeat(call: Call, count: int) -> list[float]:
    """Time a call several times; returns the seconds of each."""
    return [seconds_of(call) for _ in range(count)]


def time_in_turn(
    calls: Mapping[str, Call], rounds: int, *, warm_up: bool = False, patience: float = math.inf
) -> dict[str, list[float]]:
    """Time each call once per round, so that background load affects all of them alike.

    Parameters
    ----------
    calls : mapping of str to callable
    rounds : int
    warm_up : bool
        Run an untimed round first, which compiles.
    patience : float
        Calls that took more seconds than this in all rounds together are not repeated.

    Returns
    -------
    dict of str to list of float
        Seconds of each run, at least one.
    """
    if warm_up:
        for call in calls.values():
            call()
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        gc.collect()  # not while one of them is timed
        for name, call in calls.items():
            if not seconds[name] or sum(seconds[name]) <= patience:
                seconds[name].append(seconds_of(call))
    return seconds


def median_times(
    calls: Mapping[str, Call], rounds: int, *, warm_up: bool = True, patience: float = math.inf
) -> dict[str, float]:
    """Median seconds of each call; see `time_in_turn`."""
    found = time_in_turn(calls, rounds, warm_up=warm_up, patience=patience)
    return {name: statistics.median(seconds) for name, seconds in found.items()}
