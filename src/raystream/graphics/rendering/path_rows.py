"""Rows for the paths of pixels behind glass, which spawns two of each: see path_rows.wgsl."""

from __future__ import annotations

from typing import Any

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer
from raystream.graphics.errors import GraphicsError

#: Paths of a pixel and bounce at first, and at most: records count them in eight bits.
_FIRST_ROOM, _MOST_ROOM = 2, 128

#: Paths for which a band's buffer can have room; with more its pixels must be fewer.
_USUAL_ROOM = 16

#: Three texels.
_ROW_BYTES = 48


class PathRows:
    """A buffer with rows for the paths of this bounce and of the one before, of each pixel.

    Parameters
    ----------
    opened : OpenDevice

    Attributes
    ----------
    room : int
        Rows of a pixel and bounce.
    """

    def __init__(self, opened: OpenDevice) -> None:
        self._opened = opened
        self._pixel_count = 0
        self.room = _FIRST_ROOM
        self._buffer = Buffer(opened, "paths behind glass")

    @property
    def binding(self) -> dict[str, Any]:
        """The buffer as a resource of a bind group."""
        return self._buffer.binding

    def begin(self, pixel_count: int) -> None:
        """Room for two paths of each pixel."""
        self._pixel_count, self.room = pixel_count, _FIRST_ROOM
        self._buffer.reserve(self._half_bytes() * 2)

    def grow(self, encoder: Any) -> None:
        """Room for twice as many paths, after the same ones as before.

        Raises
        ------
        GraphicsError
            If records cannot count them, or the buffer would be too large.
        """
        old, bytes_before = self._buffer, self._half_bytes()
        self.room *= 2
        if self.room > _MOST_ROOM:
            raise GraphicsError(
                f"device 'graphics': a pixel has more than {_MOST_ROOM} paths at once behind "
                "glass; use fewer max_bounces, a larger min_weight, or device='cpu'"
            )
        self._buffer = Buffer(self._opened, "paths behind glass; render with a smaller size")
        self._buffer.reserve(self._half_bytes() * 2)
        for half in range(2):
            encoder.copy_buffer_to_buffer(
                old.handle,
                half * bytes_before,
                self._buffer.handle,
                half * self._half_bytes(),
                bytes_before,
            )

    def _half_bytes(self) -> int:
        return self._pixel_count * self.room * _ROW_BYTES

    @staticmethod
    def most_pixels(opened: OpenDevice) -> int:
        """Pixels of a band whose rows still fit when they have grown a few times."""
        most = min(
            opened.limits["max-storage-buffer-binding-size"], opened.limits["max-buffer-size"]
        )
        return max(int(most) // (2 * _USUAL_ROOM * _ROW_BYTES), 1)
