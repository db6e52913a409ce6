"""Who is told when kernels are compiled. Imports no compiler, so that watching costs nothing."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol

__all__ = ["LISTENERS", "CompileListener", "watch"]


class CompileListener(Protocol):
    """Is told when a kernel that this process needs is not on disk."""

    def begin(self, kernel: str) -> None:
        """Take note that it is going to be compiled, here or by another process."""

    def end(self, kernel: str, seconds: float) -> None:
        """Take note that it is there, and how long that took."""


#: All of them.
LISTENERS: list[CompileListener] = []


@contextlib.contextmanager
def watch(watcher: CompileListener) -> Iterator[None]:
    """Tell a watcher what is compiled while the block runs."""
    LISTENERS.append(watcher)
    try:
        yield
    finally:
        LISTENERS.remove(watcher)
