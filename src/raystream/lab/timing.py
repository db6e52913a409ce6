"""Timing: several contenders in turn, so that a busy moment hits all of them."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["Timed", "time_in_turn"]

#: Who took more seconds than this in all rounds together is not asked again.
PATIENCE = 8.0

#: ``best`` and ``median``, in seconds, and in how many ``rounds``.
Timed = dict[str, Any]


def time_in_turn(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Timed]:
    """Time calls, one after another in each round.

    Parameters
    ----------
    calls : mapping of str to callable
        Compiled already.
    rounds : int

    Returns
    -------
    dict of str to Timed
    """
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        gc.collect()  # not while one of them is timed
        for name, call in calls.items():
            if seconds[name] and sum(seconds[name]) > PATIENCE:
                continue
            seconds[name].append(_seconds(call))
    return {
        name: {"best": min(each), "median": statistics.median(each), "rounds": len(each)}
        for name, each in seconds.items()
    }


def _seconds(call: Callable[[], object]) -> float:
    started = time.perf_counter()
    call()
    return time.perf_counter() - started
