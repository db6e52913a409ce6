"""Cores: keeping every contender to the same number of them."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

__all__ = ["limited_to"]


@contextlib.contextmanager
def limited_to(count: int) -> Iterator[None]:
    """Keep this process to `count` cores, where the system can.

    Threads that start within the block may run on these cores only, whatever they are told
    otherwise, so packages that cannot be told are kept to them too. Packages should be
    imported within the block: some make their threads then.

    Parameters
    ----------
    count : int
        At least 1; with as many as the process may use already, or more, nothing changes.
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
