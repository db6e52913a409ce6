"""EXR files: reading and writing images with their layers as channels."""

from __future__ import annotations

import os
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.core.memory import check_memory
from raystream.rendering.arguments import MAX_PIXELS
from raystream.rendering.layers import channels_of, layers_of
from raystream.rendering.software_tag import SOFTWARE

_MAX_CHANNELS = 1000

#: Memory per number: in a channel being read, and in a layer.
_BYTES_PER_NUMBER = 8


def write_exr(path: str, pixels: NDArray[np.float32], layers: Mapping[str, NDArray[Any]]) -> None:
    """Write an image with its layers, with lossless compression.

    Parameters
    ----------
    path : str
    pixels : ndarray of shape (H, W, 3), float32
        Channels R, G and B.
    layers : mapping of str to ndarray
        See `layers.channels_of`. Integers keep their bits, as unsigned ones.

    Raises
    ------
    ImportError
        If OpenEXR is not installed.
    ValueError
        If two layers would share a channel.
    OSError
        If the file cannot be written.
    """
    openexr = _openexr("writing")
    channels = {name: np.ascontiguousarray(pixels[:, :, k]) for k, name in enumerate("RGB")}
    for name, plane in channels_of(layers):
        if name in channels:
            raise ValueError(f"layers: two have the channel {name!r}")
        plane = np.ascontiguousarray(plane)
        channels[name] = plane.view(np.uint32) if plane.dtype == np.int32 else plane
    header = {
        "compression": openexr.ZIP_COMPRESSION,
        "type": openexr.scanlineimage,
        "software": SOFTWARE,
    }
    with openexr.File(header, channels) as file:
        file.write(path)


def read_exr(path: str) -> tuple[NDArray[np.float32], dict[str, NDArray[Any]]]:
    """Read an image with its layers.

    Parameters
    ----------
    path : str

    Returns
    -------
    pixels : ndarray of shape (H, W, 3), float32
        Of the channels R, G and B, or of Y alone.
    layers : dict of str to ndarray
        All other channels, see `layers.layers_of`: float32, or int32 where the file has
        integers.

    Raises
    ------
    ImportError
        If OpenEXR is not installed.
    FileFormatError
        If the file is missing, corrupt or too large, has several parts, subsampled channels, or
        no colours.
    MemoryError
        If it does not fit into memory.
    """
    openexr = _openexr("reading")
    if not os.path.isfile(path):
        raise FileFormatError(path, "is a folder" if os.path.isdir(path) else "no such file")
    try:
        with openexr.File(path, separate_channels=True, header_only=True) as file:
            _check_header(path, openexr, len(file.parts), file.header())
        with openexr.File(path, separate_channels=True) as file:
            if not file.parts:  # OpenEXR prints why, and raises nothing
                raise FileFormatError(path, "is not a complete .exr file")
            channels = {name: _plain(it.pixels) for name, it in file.channels().items()}
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:  # OpenEXR raises many types for corrupt files
        raise FileFormatError(path, f"is not a complete .exr file ({error})") from error
    colors = [channels.pop(name, None) for name in "RGB"]
    if all(plane is None for plane in colors) and "Y" in channels:
        colors = [channels.pop("Y")] * 3
    known = [plane for plane in colors if plane is not None]
    if len(known) < 3:
        raise FileFormatError(path, "has no colours: expected the channels R, G and B, or Y")
    return np.stack(known, axis=-1).astype(np.float32, copy=False), layers_of(channels)


def _check_header(path: str, openexr: ModuleType, part_count: int, header: dict[str, Any]) -> None:
    """Check the header, before pixels are read."""
    if part_count != 1:
        raise FileFormatError(path, f"has {part_count} parts; multi-part files are not supported")
    if header["type"] not in (openexr.scanlineimage, openexr.tiledimage):
        raise FileFormatError(path, "is a deep image, which is not supported")
    low, high = header["dataWindow"]
    width, height = (int(high[k]) - int(low[k]) + 1 for k in range(2))
    channels = header["channels"]
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise FileFormatError(path, f"image of {width}x{height} is too large")
    if len(channels) > _MAX_CHANNELS:
        raise FileFormatError(path, f"has {len(channels)} channels; at most {_MAX_CHANNELS}")
    if any(channel.xSampling != 1 or channel.ySampling != 1 for channel in channels):
        raise FileFormatError(path, "has subsampled channels, which are not supported")
    byte_count = width * height * len(channels) * _BYTES_PER_NUMBER
    check_memory(byte_count, f"{path}: {len(channels)} channels of {width}x{height} would")


def _plain(plane: NDArray[Any]) -> NDArray[Any]:
    """A channel as float32 or, if it has unsigned integers, as int32 with the same bits."""
    if plane.dtype == np.uint32:
        return np.ascontiguousarray(plane).view(np.int32)
    return plane.astype(np.float32, copy=False)


def _openexr(purpose: str) -> ModuleType:
    try:
        import OpenEXR
    except ImportError:
        raise ImportError(f"{purpose} .exr needs OpenEXR: pip install 'raystream[exr]'") from None
    return OpenEXR
