"""Cores: limit every contender to the same number of them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def limit_cores(count: int) -> Iterator[None]:
    """Limit this process to `count` cores, if the system supports it.

    Threads started within the block run on these cores only, whatever their settings, so the
    limit also applies to packages without a thread setting. Import packages within the block:
    some start their threads on import.

    Parameters
    ----------
    count : int
        At least 1; no effect if the process may not use more cores anyway.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    if count >= len(allowed):
        yield
        return
    os.sched_setaffinity(0, sorted(allowed)[:count])
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)
