"""Texture: a bitmap, read on first use."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError

#: a, b, c, d, e, f: u and v become a u + b v + c and d u + e v + f.
Affine = tuple[float, float, float, float, float, float]

#: Behaviour outside [0, 1]: of both axes, or of u and of v.
Wrap = Literal["repeat", "clamp", "mirror"]
Wraps = Wrap | tuple[Wrap, Wrap]

WRAPS = ("repeat", "clamp", "mirror")

#: Tags of TIFF files: bits of a number, and 0 where white is 0.
_BITS_PER_SAMPLE, _PHOTOMETRIC = 258, 262

#: Larger images are rejected before decoding: a few kilobytes can claim terabytes.
MAX_TEXTURE_PIXELS = 1 << 28

#: Supported formats. Pillow detects more by content, not by file name, among them programs that
#: it would run in Ghostscript. TGA has no magic number, and comes last.
FORMATS = (
    "PNG",
    "JPEG",
    "WEBP",
    "GIF",
    "BMP",
    "TIFF",
    "DDS",
    "JPEG2000",
    "PPM",
    "SGI",
    "PCX",
    "TGA",
)


class Texture:
    """A bitmap, from a file or from memory.

    Parameters
    ----------
    source : path, bytes or ndarray of shape (H, W, C), uint8
        The image file, its encoded content, or decoded pixels with the top row first: encoded
        values (sRGB for colours); C is 1, 3 or 4.
    name : str, optional
        Defaults to the file's name.
    wrap : {"repeat", "clamp", "mirror"} or tuple of two of these
        Behaviour outside [0, 1], of both axes, or along u and along v: "mirror" repeats the image
        with every other copy reversed.
    transform : tuple of six float, optional
        a, b, c, d, e, f: the image is looked up at u' = a u + b v + c and v' = d u + e v + f, where
        u and v are a mesh's coordinates and v points up [default: unchanged]. It moves normal and
        bump maps, but does not rotate their normals.

    Raises
    ------
    ValueError, TypeError
        If an argument has the wrong type, shape or range. Files are read on first use.
    """

    def __init__(
        self,
        source: str | PathLike[str] | bytes | NDArray[np.uint8],
        *,
        name: str = "",
        wrap: Wraps = "repeat",
        transform: Affine | None = None,
    ) -> None:
        self.wraps = _wraps(wrap)
        if transform is not None:
            a, b, c, d, e, f = _numbers(transform)
            transform = a, b, c, d, e, f
        if isinstance(source, str | PathLike):
            source = Path(source)
        elif isinstance(source, np.ndarray):
            _check_pixels(source)
        elif not isinstance(source, bytes):
            raise TypeError(
                f"source: expected a path, bytes or an array, got {type(source).__name__}"
            )
        self.path = source if isinstance(source, Path) else None
        self.name = name or (self.path.name if self.path else "")
        self.transform = transform
        self._encoded = source if isinstance(source, bytes) else None
        self._pixels = source if isinstance(source, np.ndarray) else None
        self._made: tuple[Texture, Callable[[NDArray[np.uint8]], NDArray[np.uint8]]] | None = None

    @property
    def wrap(self) -> Wraps:
        """As `wraps`, of u and v; one word if both have the same."""
        return self.wraps[0] if self.wraps[0] == self.wraps[1] else self.wraps

    def pixels(self) -> NDArray[np.uint8]:
        """Decode the image; cached.

        Returns
        -------
        ndarray of shape (H, W, C), uint8
            C is 1, 3 or 4; encoded values (sRGB for colours), top row first. Greys of more than 8
            bits are rounded to bytes: white is 65535 (4095 of 12 bits), and 1 in floats.

        Raises
        ------
        FileFormatError
            If the image cannot be read, or has more than `MAX_TEXTURE_PIXELS` pixels, or greys of
            32 bits below 0 or above white.
        """
        if self._pixels is None:
            self._pixels = self._decode()
        return self._pixels

    def alpha(self) -> Texture:
        """Return the alpha channel as a texture of shape (H, W, 1); 255 if there is none.

        The image is read on first use of the channel.
        """
        return self.changed(_alpha_of)

    def changed(self, change: Callable[[NDArray[np.uint8]], NDArray[np.uint8]]) -> Texture:
        """Return a texture whose pixels are computed from this one's on first use.

        Parameters
        ----------
        change : callable
            Maps pixels of shape (H, W, C), as `pixels` returns them, to new ones. It must be
            picklable, since scenes are sent to other processes.
        """
        made = Texture(b"", name=self.name, wrap=self.wrap, transform=self.transform)
        made._made = self, change
        return made

    def _decode(self) -> NDArray[np.uint8]:
        from PIL import Image

        if self._made is not None:
            whole, change = self._made
            return change(whole.pixels())

        label = str(self.path) if self.path else self.name or "embedded image"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                source = self.path if self.path else io.BytesIO(self._encoded or b"")
                with Image.open(source, formats=FORMATS) as image:
                    width, height = image.size
                    if width * height > MAX_TEXTURE_PIXELS:
                        raise FileFormatError(label, f"image of {width}x{height} is too large")
                    return pixels_of(image)
        except FileFormatError:
            raise
        except Exception as error:  # Pillow raises many kinds for damaged files
            raise FileFormatError(label, f"cannot read this image ({error})") from error

    def __repr__(self) -> str:
        return f"Texture({self.name!r}, wrap={self.wrap!r})"


def pixels_of(image: Any) -> NDArray[np.uint8]:
    """Decode an image of any mode that Pillow opens.

    Parameters
    ----------
    image : PIL.Image.Image
        White is 65535 in greys of 16 and 32 bits, 4095 in those of 12 bits, and 1 in floats.

    Returns
    -------
    ndarray of shape (H, W, C), uint8
        C is 1 for greys, 4 with alpha or a transparent colour, and otherwise 3.

    Raises
    ------
    ValueError
        If greys of 32 bits or floats are below 0, above white, or NaN: what is white is unknown.
    """
    if image.mode.startswith(("I", "F")):
        return _deep_greys(image)
    has_alpha = "A" in image.getbands() or "transparency" in image.info
    grey = "L" if image.mode == "L" else "RGB"
    pixels = np.asarray(image.convert("RGBA" if has_alpha else grey), np.uint8)
    return pixels[:, :, None] if pixels.ndim == 2 else pixels


def _deep_greys(image: Any) -> NDArray[np.uint8]:
    """Greys of more than 8 bits. Pillow's own conversion makes 255 and more white."""
    tags = getattr(image, "tag_v2", {})
    bits = tags.get(_BITS_PER_SAMPLE, (16,))[0]
    white = 1.0 if image.mode == "F" else float((1 << min(bits, 16)) - 1)
    values = np.asarray(image)
    low, high = float(values.min()), float(values.max())
    if not (low >= 0.0 and high <= white):
        raise ValueError(
            f"its greys are from {low:g} to {high:g}, not from 0 to {white:g}; "
            "scale them, and save it with 8 or 16 bits"
        )
    greys = np.rint(values / (white / 255.0)).astype(np.uint8)[:, :, None]
    greys = 255 - greys if tags.get(_PHOTOMETRIC) == 0 else greys
    transparent = image.info.get("transparency")
    if transparent is None:
        return greys
    alpha = np.where(values == transparent, 0, 255).astype(np.uint8)[:, :, None]
    return np.concatenate([greys, greys, greys, alpha], axis=2)


def _alpha_of(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The alpha channel of an image; 255 without one."""
    return pixels[:, :, 3:] if pixels.shape[2] == 4 else np.full_like(pixels[:, :, :1], 255)


def _check_pixels(pixels: NDArray[np.uint8]) -> None:
    """Raise if an array is not an image: one of floats from 0 to 1 would be black."""
    if pixels.dtype != np.uint8:
        raise TypeError(f"source: expected pixels of dtype uint8, 0 to 255, got {pixels.dtype}")
    if pixels.ndim != 3 or pixels.shape[2] not in (1, 3, 4) or 0 in pixels.shape:
        raise ValueError(
            f"source: expected pixels of shape (H, W, C), C 1, 3 or 4, got {pixels.shape}"
        )


def _wraps(wrap: Any) -> tuple[Wrap, Wrap]:
    both = tuple(wrap) if isinstance(wrap, (tuple, list)) else (wrap, wrap)
    if len(both) != 2 or not all(one in WRAPS for one in both):
        raise ValueError(f"wrap: expected one of {', '.join(WRAPS)}, or two, got {wrap!r}")
    return both[0], both[1]


def _numbers(transform: Affine) -> list[float]:
    numbers = [float(number) for number in transform]
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise ValueError(f"transform: expected six finite numbers, got {transform}")
    return numbers
