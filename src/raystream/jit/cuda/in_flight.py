"""InFlight: what must not be freed before a device has read it."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.streams import CudaStream

__all__ = ["InFlight"]


class InFlight:
    """Keeps callers' objects until the work that was begun with them is done.

    Nobody waits: each time that something is kept, what is done by then is let go.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[Any, Any]] = deque()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kept)

    def keep(self, stream: CudaStream, objects: Any) -> None:
        """Keep objects until a stream has done what it was given so far."""
        if is_simulated():
            return
        done = []  # freed outside the lock: what frees them may come here
        event = stream.native.record()
        with self._lock:
            self._kept.append((event, objects))
            while self._kept[0][0].is_done:
                done.append(self._kept.popleft())
                if not self._kept:
                    break
