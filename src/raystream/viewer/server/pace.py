"""Pace: how fast one client is listened to."""

from __future__ import annotations

import asyncio
import time

__all__ = ["Pace"]

#: Messages a second in the long run, and at once after a rest. A page that follows a mouse
#: sends some hundred.
RATE = 400.0
BURST = 800.0


class Pace:
    """Slows down a client that sends too fast; what it sends waits in its own computer."""

    def __init__(self) -> None:
        self._left = BURST
        self._last = time.monotonic()

    async def wait(self) -> None:
        """Count a message, and wait if there were too many of late."""
        now = time.monotonic()
        self._left = min(BURST, self._left + (now - self._last) * RATE) - 1.0
        self._last = now
        if self._left < 0.0:
            await asyncio.sleep(-self._left / RATE)
