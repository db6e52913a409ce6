"""RateLimiter: limits how fast one client may send."""

from __future__ import annotations

import asyncio
import time

#: Sustained messages per second, and burst size. A page that follows a mouse sends a few hundred.
RATE = 400.0
BURST = 800.0


class RateLimiter:
    """Throttles a client that sends too fast, by reading from it later."""

    def __init__(self) -> None:
        self._left = BURST
        self._last = time.monotonic()

    async def wait(self) -> None:
        """Count a message, and wait if the rate is exceeded."""
        now = time.monotonic()
        self._left = min(BURST, self._left + (now - self._last) * RATE) - 1.0
        self._last = now
        if self._left < 0.0:
            await asyncio.sleep(-self._left / RATE)
