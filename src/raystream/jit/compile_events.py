"""Listeners to kernel compilation. Imports no compiler, so that listening costs no time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Protocol


class CompileListener(Protocol):
    """Receives events of kernels that this process needs and that are not on disk."""

    def begin(self, kernel: str) -> None:
        """Called before the kernel is compiled, here or by another process."""

    def end(self, kernel: str, seconds: float) -> None:
        """Called when the kernel is available, with the time that this took."""


#: Listeners of this process.
LISTENERS: list[CompileListener] = []


@contextlib.contextmanager
def listening(listener: CompileListener) -> Iterator[None]:
    """Send compile events to a listener while the block runs."""
    LISTENERS.append(listener)
    try:
        yield
    finally:
        LISTENERS.remove(listener)
