"""PNG files: reading and writing sRGB bytes."""

from __future__ import annotations

import os
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError
from raystream.core.memory import check_memory
from raystream.rendering.arguments import MAX_PIXELS
from raystream.rendering.color import decode_srgb
from raystream.rendering.software_tag import SOFTWARE
from raystream.scene.texture import pixels_of

#: Memory per pixel: as decoded bytes, and as linear float32.
_BYTES_PER_PIXEL = 20


def write_png(target: Any, encoded: NDArray[np.uint8]) -> None:
    """Write sRGB bytes of shape (H, W, 3) to a path or a stream, with the software tag."""
    from PIL import Image

    # Level 3 is twice as fast as the default 6, for files a tenth larger.
    image = Image.fromarray(encoded)
    image.save(target, format="PNG", compress_level=3, pnginfo=png_tag())


def png_tag() -> Any:
    """The software tag of a PNG, for Pillow."""
    from PIL.PngImagePlugin import PngInfo

    tag = PngInfo()
    tag.add_text("Software", SOFTWARE)
    return tag


def read_png(path: str) -> NDArray[np.float32]:
    """Read an image and decode it from sRGB.

    Parameters
    ----------
    path : str
        Greyscale becomes RGB; 16 bits are rounded to 8; alpha is dropped.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        Linear RGB in [0, 1].

    Raises
    ------
    FileFormatError
        If the file is missing, not a PNG, corrupt or too large.
    MemoryError
        If it does not fit into memory.
    """
    from PIL import Image

    if not os.path.isfile(path):
        raise FileFormatError(path, "is a folder" if os.path.isdir(path) else "no such file")
    try:
        with warnings.catch_warnings():
            # Sizes are checked here: Pillow's limit is not ours.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path, formats=["PNG"]) as image:
                width, height = image.size
                if width * height > MAX_PIXELS:
                    raise FileFormatError(path, f"image of {width}x{height} is too large")
                byte_count = width * height * _BYTES_PER_PIXEL
                check_memory(byte_count, f"{path}: an image of {width}x{height} would")
                encoded = pixels_of(image)[:, :, :3]
    except (FileFormatError, MemoryError):
        raise
    except Exception as error:  # Pillow raises many types for corrupt files
        raise FileFormatError(path, f"is not a complete .png file ({error})") from error
    return decode_srgb(np.repeat(encoded, 3 // encoded.shape[2], axis=2))
