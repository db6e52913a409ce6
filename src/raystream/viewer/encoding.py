"""Encoding: from linear colours to the bytes of image files, beside the rendering."""

from __future__ import annotations

import io
import queue
import threading
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from raystream.rendering.image import Image
from raystream.rendering.png import write_png
from raystream.viewer.messages import Frame, Message
from raystream.viewer.settings import Look

__all__ = ["Encoder", "encode_jpeg", "encode_png"]

#: Qualities of JPEG while the camera moves and while it is still.
MOVING_QUALITY, STILL_QUALITY = 80, 92


def encode_jpeg(pixels: NDArray[np.float32], look: Look, quality: int) -> bytes:
    """A JPEG of linear colours, of shape (H, W, 3)."""
    shown = PillowImage.fromarray(Image(pixels).to_bytes(look.exposure, look.tone))
    buffer = io.BytesIO()
    shown.save(buffer, "JPEG", quality=quality, subsampling=0 if quality > 90 else 2)
    return buffer.getvalue()


def encode_png(pixels: NDArray[np.float32], look: Look) -> bytes:
    """A PNG of linear colours, of shape (H, W, 3)."""
    buffer = io.BytesIO()
    write_png(buffer, Image(pixels).to_bytes(look.exposure, look.tone))
    return buffer.getvalue()


class Encoder:
    """A thread that encodes pictures one after another, while the next ones are rendered."""

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(
            target=self._run, name="raystream viewer encoder", daemon=True
        )
        self._thread.start()

    def encode(
        self,
        encode: Callable[[], bytes],
        header: Message,
        done: Callable[[Frame], object],
        failed: Callable[[Exception], object],
    ) -> None:
        """Encode a picture when it is its turn.

        Parameters
        ----------
        encode : callable
            Returns the bytes.
        header : dict
            Gets ``encode_ms``.
        done, failed : callable
            Called from the encoder's thread with the frame, or with what went wrong.
        """

        def work() -> None:
            try:
                started = time.perf_counter()
                content = encode()
                header["encode_ms"] = round(1e3 * (time.perf_counter() - started), 3)
            except Exception as error:  # too large for memory, say: the others go on
                failed(error)
            else:
                done(Frame(header, content))

        self._waiting.put(work)

    def close(self, timeout: float = 10.0) -> None:
        """End the thread, after what waits."""
        self._waiting.put(None)
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            work = self._waiting.get()
            if work is None:
                return
            work()
