"""Encoding: convert linear colours to image files, in parallel with rendering."""

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
from raystream.viewer.settings import DisplaySettings

#: JPEG quality while the camera moves and while it rests.
MOVING_QUALITY, STILL_QUALITY = 80, 92


def encode_jpeg(pixels: NDArray[np.float32], display: DisplaySettings, quality: int) -> bytes:
    """Encode linear colours of shape (H, W, 3) as a JPEG."""
    shown = PillowImage.fromarray(Image(pixels).to_bytes(display.exposure, display.tone))
    buffer = io.BytesIO()
    shown.save(buffer, "JPEG", quality=quality, subsampling=0 if quality > 90 else 2)
    return buffer.getvalue()


def encode_png(pixels: NDArray[np.float32], display: DisplaySettings) -> bytes:
    """Encode linear colours of shape (H, W, 3) as a PNG."""
    buffer = io.BytesIO()
    write_png(buffer, Image(pixels).to_bytes(display.exposure, display.tone))
    return buffer.getvalue()


class Encoder:
    """A thread that encodes images in order, while the next ones are rendered."""

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
        """Queue an image for encoding.

        Parameters
        ----------
        encode : callable
            Returns the bytes.
        header : dict
            Gets ``encode_ms``.
        done, failed : callable
            Called on the encoder's thread with the frame or the error.
        """

        def work() -> None:
            try:
                started = time.perf_counter()
                content = encode()
                header["encode_ms"] = round(1e3 * (time.perf_counter() - started), 3)
            except Exception as error:  # out of memory, say: other images continue
                failed(error)
            else:
                done(Frame(header, content))

        self._waiting.put(work)

    def close(self, timeout: float = 10.0) -> None:
        """Stop the thread once its queue is empty."""
        self._waiting.put(None)
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            work = self._waiting.get()
            if work is None:
                return
            work()
