"""Who is told when kernels are compiled. Imports no compiler, so that watching costs nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol

__all__ = ["WATCHERS", "Watcher", "watch"]


class Watcher(Protocol):
    """Is told when a kernel that this process needs is not on disk."""

    def begin(self, kernel: str) -> None:
        """Take note that it is going to be compiled, here or by another process."""

    def end(self, kernel: str, seconds: float) -> None:
        """Take note that it is there, and how long that took."""


#: All of them.
WATCHERS: list[Watcher] = []


@contextlib.contextmanager
def watch(watcher: Watcher) -> Iterator[None]:
    """Tell a watcher what is compiled while the block runs."""
    WATCHERS.append(watcher)
    try:
        yield
    finally:
        WATCHERS.remove(watcher)
