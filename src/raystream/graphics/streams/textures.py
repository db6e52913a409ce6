"""Textures of streams: a record of four words per texel."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError
from raystream.graphics.textures import FLOATS, WORDS, Texture, new_texture

#: Four words.
TEXEL_BYTES = 16

#: Widths are multiples of this: such rows can be copied without padding.
_COLUMNS = 16

_FORMATS = {"f": FLOATS, "u": WORDS}


class StreamShape(NamedTuple):
    """The shape of a texture of records, row by row; the last row may be partly unused.

    Attributes
    ----------
    width, height : int
    """

    width: int
    height: int

    @classmethod
    def for_count(cls, count: int, opened: OpenDevice) -> StreamShape:
        """A nearly square shape.

        Raises
        ------
        GraphicsError
            If they do not fit in a texture of the device.
        """
        most = opened.limits["max-texture-dimension-2d"]
        columns = -(-max(math.isqrt(max(count - 1, 0)) + 1, 1) // _COLUMNS) * _COLUMNS
        width = min(columns, most // _COLUMNS * _COLUMNS)
        height = max(-(-count // width), 1)
        if height > most:
            raise GraphicsError(
                f"device 'graphics': {count:,} records do not fit in a texture of {opened.adapter}"
            )
        return cls(width, height)


class StreamTexture(Texture):
    """A stream as a texture.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.
    shape : StreamShape
    dtype : dtype
        float32 or uint32.
    """

    def __init__(self, opened: OpenDevice, name: str, shape: StreamShape, dtype: Any) -> None:
        super().__init__(opened, name, shape, _FORMATS[np.dtype(dtype).kind])

    def write_records(self, records: NDArray[Any]) -> None:
        """Write the first records, of shape (N, k), k up to 4; the rest of their rows is 0."""
        width = self.size[0]
        rows = -(-len(records) // width)
        if rows == 0:
            return
        texels = np.zeros((rows * width, 4), self._dtype)
        texels[: len(records), : records.shape[1]] = records
        self.write(texels.reshape(rows, width, 4))

    def read_records(self, count: int) -> NDArray[Any]:
        """Wait for the device, and read the first records: shape (N, 4)."""
        return self.read(-(-count // self.size[0])).reshape(-1, 4)[:count]


class StencilTexture:
    """The states of records: one byte each.

    Attributes
    ----------
    view : GPUTextureView
        For render passes.
    states : GPUTextureView
        For shaders: a texture_2d<u32>.
    """

    format = "stencil8"

    def __init__(self, opened: OpenDevice, shape: StreamShape) -> None:
        import wgpu

        usage = wgpu.TextureUsage.TEXTURE_BINDING | wgpu.TextureUsage.RENDER_ATTACHMENT
        texture = new_texture(opened, "the stencil", shape, self.format, usage)
        self.view = texture.create_view()
        self.states = texture.create_view(aspect="stencil-only")
