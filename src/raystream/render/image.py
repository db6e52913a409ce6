"""Image: a picture in linear colours, and its files."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.whole_file import replacing
from raystream.render.color import encode_srgb

__all__ = ["IMAGE_SUFFIXES", "Image"]


class Image:
    """A picture.

    Parameters
    ----------
    pixels : array_like of shape (H, W, 3), float
        Linear RGB, top row first.

    Attributes
    ----------
    pixels : ndarray of shape (H, W, 3), float32

    Raises
    ------
    ValueError
        If the shape is another.
    """

    def __init__(self, pixels: ArrayLike) -> None:
        self.pixels: NDArray[np.float32] = np.ascontiguousarray(pixels, np.float32)
        if self.pixels.ndim != 3 or self.pixels.shape[2] != 3 or 0 in self.pixels.shape:
            raise ValueError(f"pixels: expected shape (H, W, 3), got {self.pixels.shape}")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def save(self, path: str | PathLike[str], *, exposure: float = 1.0) -> None:
        """Write the picture to a file, which appears, or is replaced, as a whole.

        Parameters
        ----------
        path : str or path
            ``.png``: sRGB, 8 bits. ``.exr``: linear float32 (needs ``raystream[exr]``).
        exposure : float
            Factor on the colours of a PNG; EXR keeps them as they are.

        Raises
        ------
        ValueError
            If the name ends in something else, or `exposure` is not a number above 0.
        ImportError
            If EXR is wanted and OpenEXR is not installed.
        OSError
            If the file cannot be written.
        """
        target = Path(path)
        writer = IMAGE_SUFFIXES.get(target.suffix.lower())
        if writer is None:
            raise ValueError(f"{target}: the name must end in {' or '.join(IMAGE_SUFFIXES)}")
        _check_exposure(exposure)
        with replacing(target) as temporary:
            writer(self, str(temporary), exposure)

    def to_bytes(self, exposure: float = 1.0) -> NDArray[np.uint8]:
        """Encode as sRGB.

        Parameters
        ----------
        exposure : float

        Returns
        -------
        ndarray of shape (H, W, 3), uint8
        """
        return encode_srgb(self.pixels, exposure)

    def _write_png(self, target: Any, exposure: float) -> None:
        from PIL import Image as PillowImage

        # Level 3 is twice as fast as the default 6, for files a tenth larger.
        PillowImage.fromarray(self.to_bytes(exposure)).save(target, format="PNG", compress_level=3)

    def _write_exr(self, target: str, _exposure: float) -> None:
        try:
            import OpenEXR
        except ImportError:
            raise ImportError("writing .exr needs OpenEXR: pip install 'raystream[exr]'") from None
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": self.pixels}) as file:
            file.write(target)

    def _repr_png_(self) -> bytes:
        """Show the picture in a notebook."""
        buffer = io.BytesIO()
        self._write_png(buffer, 1.0)
        return buffer.getvalue()

    def __repr__(self) -> str:
        return f"Image({self.size[0]}x{self.size[1]})"


#: Writers by the suffix of the file.
IMAGE_SUFFIXES: dict[str, Callable[[Image, str, float], None]] = {
    ".png": Image._write_png,
    ".exr": Image._write_exr,
}


def _check_exposure(exposure: float) -> None:
    if not (math.isfinite(exposure) and exposure > 0.0):
        raise ValueError(f"exposure: expected a number above 0, got {exposure}")
