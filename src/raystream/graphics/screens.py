"""Screens: textures with a record for each pixel of a picture."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.errors import GraphicsError

__all__ = [
    "FLOATS",
    "IDS",
    "WORDS",
    "Screen",
    "clear_screen",
    "new_screen",
    "read_screen",
    "sampled",
]

#: Formats: four float32, four uint32, and one int32 of each pixel.
FLOATS, WORDS, IDS = "rgba32float", "rgba32uint", "r32sint"

_DTYPES = {FLOATS: (np.float32, 4), WORDS: (np.uint32, 4), IDS: (np.int32, 1)}


class Screen(NamedTuple):
    """A texture as large as a picture.

    Attributes
    ----------
    size : (int, int)
        Width and height in pixels.
    format : str
    handle : GPUTexture
    view : GPUTextureView
    """

    size: tuple[int, int]
    format: str
    handle: Any
    view: Any


def new_screen(opened: OpenDevice, size: tuple[int, int], format: str, name: str) -> Screen:  # noqa: A002
    """Make a texture that fragment programs write, and read later.

    Raises
    ------
    GraphicsError
        If it is larger than the device allows, or there is no memory for it.
    """
    import wgpu

    most = opened.limits["max-texture-dimension-2d"]
    if max(size) > most:
        raise GraphicsError(
            f"device 'graphics': a picture of {size[0]}x{size[1]} pixels is larger than the "
            f"{most:,} on a side that {opened.adapter} allows"
        )
    usage = wgpu.TextureUsage.RENDER_ATTACHMENT | wgpu.TextureUsage.TEXTURE_BINDING
    usage |= wgpu.TextureUsage.COPY_SRC
    try:
        handle = opened.device.create_texture(
            size=(*size, 1), format=format, usage=usage, label=name
        )
        return Screen(size, format, handle, handle.create_view())
    except Exception as error:  # wgpu wraps whatever a driver says
        raise GraphicsError(
            f"device 'graphics': {opened.adapter} has no memory for {name}, {size[0]}x{size[1]} "
            f"pixels: {error}"
        ) from error


def clear_screen(encoder: Any, screen: Screen, value: float) -> None:
    """Set all numbers of a texture."""
    attachment = {"view": screen.view, "clear_value": (value,) * 4}
    attachment |= {"load_op": "clear", "store_op": "store"}
    encoder.begin_render_pass(color_attachments=[attachment]).end()


def read_screen(opened: OpenDevice, screen: Screen) -> NDArray[Any]:
    """Copy a texture back, when the device has done what it was given.

    Returns
    -------
    ndarray of shape (height, width, 4), float32 or uint32; or (height, width, 1), int32
    """
    dtype, channels = _DTYPES[screen.format]
    width, height = screen.size
    memory = opened.device.queue.read_texture(
        {"texture": screen.handle},
        {"bytes_per_row": width * channels * np.dtype(dtype).itemsize, "rows_per_image": height},
        (width, height, 1),
    )
    return np.frombuffer(memory, dtype).reshape(height, width, channels)


def sampled(format: str) -> dict[str, Any]:  # noqa: A002
    """What a layout of a bind group says of a texture that is read."""
    kind = {WORDS: "uint", IDS: "sint"}.get(format, "unfilterable-float")
    return {"texture": {"sample_type": kind, "view_dimension": "2d"}}
