"""Textures that fragment programs write and read: a record per texel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError

#: Formats: four float32, four uint32, or one int32 per texel.
FLOATS, WORDS, IDS = "rgba32float", "rgba32uint", "r32sint"

#: Dtype and channels of all formats: those, and the same with one, two or four channels.
_DTYPES = {
    f"{channels}32{kind}": (dtype, len(channels))
    for channels in ("r", "rg", "rgba")
    for kind, dtype in (("float", np.float32), ("uint", np.uint32), ("sint", np.int32))
}


class Texture:
    """A texture that fragment programs write, then read.

    Parameters
    ----------
    opened : OpenDevice
    name : str
        For errors.
    size : (int, int)
        Width and height in texels.
    format : str
        FLOATS, WORDS, IDS, or another of one, two or four numbers of 32 bits.

    Attributes
    ----------
    size : (int, int)
    format : str
    view : GPUTextureView

    Raises
    ------
    GraphicsError
        If it is larger than the device allows, or there is no memory for it.
    """

    def __init__(
        self,
        opened: OpenDevice,
        name: str,
        size: tuple[int, int],
        format: str,  # noqa: A002
    ) -> None:
        import wgpu

        usage = wgpu.TextureUsage
        self.size = size
        self.format = format
        self._dtype, self._channels = _DTYPES[format]
        self._queue = opened.device.queue
        self._handle = new_texture(
            opened,
            name,
            size,
            format,
            usage.RENDER_ATTACHMENT | usage.TEXTURE_BINDING | usage.COPY_SRC | usage.COPY_DST,
        )
        self.view = self._handle.create_view()

    def _layout(self, rows: int) -> dict[str, int]:
        bytes_per_row = self.size[0] * self._channels * np.dtype(self._dtype).itemsize
        return {"bytes_per_row": bytes_per_row, "rows_per_image": rows}

    def write(self, texels: NDArray[Any]) -> None:
        """Copy texels to its first rows: shape (rows, width, channels), of its dtype."""
        rows = len(texels)
        self._queue.write_texture(
            {"texture": self._handle},
            np.ascontiguousarray(texels),
            self._layout(rows),
            (self.size[0], rows, 1),
        )

    def read(self, rows: int | None = None) -> NDArray[Any]:
        """Wait for the device, and copy its first rows back, or all.

        Returns
        -------
        ndarray of shape (rows, width, channels)
            Of the format's dtype.
        """
        width, height = self.size
        rows = height if rows is None else rows
        if rows == 0:
            return np.empty((0, width, self._channels), self._dtype)
        memory = self._queue.read_texture(
            {"texture": self._handle}, self._layout(rows), (width, rows, 1)
        )
        return np.frombuffer(memory, self._dtype).reshape(rows, width, self._channels)

    def copy_to(self, encoder: Any, other: Texture) -> None:
        """Copy all texels to a texture of the same size and format."""
        encoder.copy_texture_to_texture(
            {"texture": self._handle}, {"texture": other._handle}, (*self.size, 1)
        )


def new_texture(
    opened: OpenDevice,
    name: str,
    size: tuple[int, int],
    format: str,  # noqa: A002
    usage: Any,
) -> Any:
    """Make a texture of any format and usage; see `Texture` for arguments and errors."""
    most = opened.limits["max-texture-dimension-2d"]
    width, height = size
    if max(size) > most:
        raise GraphicsError(
            f"device 'graphics': {name}: {width} x {height} texels are more than "
            f"the {most:,} on a side that {opened.adapter} allows"
        )
    try:
        return opened.device.create_texture(size=(*size, 1), format=format, usage=usage, label=name)
    except Exception as error:  # wgpu wraps all errors of a driver
        raise GraphicsError(
            f"device 'graphics': {opened.adapter} has no memory for {name}, "
            f"{width} x {height} texels: {error}"
        ) from error


def sampled(format: str) -> str:  # noqa: A002
    """The kind of binding that reads a format, see `pipelines.Program`."""
    return format.rpartition("32")[2]
