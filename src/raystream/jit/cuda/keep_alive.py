"""KeepAlive: objects that must not be freed before a device has read them."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.streams import CudaStream


class KeepAlive:
    """Holds references to callers' objects until the launches that use them are done.

    Nothing waits: each call of `keep` releases the objects whose launches are done by then.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[Any, Any]] = deque()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kept)

    def keep(self, stream: CudaStream, objects: Any) -> None:
        """Keep objects until a stream has done all that it has been given so far."""
        if is_simulated():
            return
        done = []  # freed outside the lock: a finalizer may call this method
        event = stream.native.record()
        with self._lock:
            self._kept.append((event, objects))
            while self._kept[0][0].is_done:
                done.append(self._kept.popleft())
                if not self._kept:
                    break
