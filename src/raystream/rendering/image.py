"""Image: a picture in linear colours, and its files."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.atomic_write import atomic_write
from raystream.rendering.color import encode_srgb
from raystream.rendering.exr import read_exr, write_exr
from raystream.rendering.layers import check_layers
from raystream.rendering.png import read_png, write_png
from raystream.rendering.tone import apply_tone, check_tone

if TYPE_CHECKING:
    from raystream.rendering.compare import Comparison

__all__ = ["IMAGE_SUFFIXES", "Image"]

#: Width or height from which on a notebook shows a smaller picture: it keeps all that it shows.
_MOST_SHOWN = 2048


class Image:
    """A picture.

    Parameters
    ----------
    pixels : array_like of shape (H, W, 3), float
        Linear RGB, top row first.
    layers : mapping of str to array_like of shape (H, W) or (H, W, 3), optional
        What else is known of each pixel: ``"depth"``, ``"normal"``, ``"albedo"``,
        ``"prim_id"``, ``"variance"`` and any other names.
    figures : mapping of str to number or str, optional
        What is known of the whole. Files do not keep it.

    Attributes
    ----------
    pixels : ndarray of shape (H, W, 3), float32
    layers : dict of str to ndarray of shape (H, W) or (H, W, 3), float32 or int32
    figures : dict

    Raises
    ------
    ValueError
        If a shape is another, or a layer is not made of numbers.
    """

    def __init__(
        self,
        pixels: ArrayLike,
        layers: Mapping[str, ArrayLike] | None = None,
        figures: Mapping[str, Any] | None = None,
    ) -> None:
        self.pixels: NDArray[np.float32] = np.ascontiguousarray(pixels, np.float32)
        if self.pixels.ndim != 3 or self.pixels.shape[2] != 3 or 0 in self.pixels.shape:
            raise ValueError(f"pixels: expected shape (H, W, 3), got {self.pixels.shape}")
        self.layers = check_layers(layers, self.pixels.shape[:2])
        self.figures: dict[str, Any] = dict(figures or {})

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Image:
        """Read a picture from a file.

        Parameters
        ----------
        path : str or path
            ``.png``: decoded from sRGB; ``.exr``: with its layers (needs ``raystream[exr]``).

        Raises
        ------
        ValueError
            If the name ends in something else.
        FileFormatError
            If there is no such file, or it is damaged or too large.
        ImportError
            If it is an EXR and OpenEXR is not installed.
        MemoryError
            If it does not fit into memory.
        """
        source = Path(path)
        suffix = source.suffix.lower()
        if suffix not in IMAGE_SUFFIXES:
            raise ValueError(f"{source}: the name must end in {' or '.join(IMAGE_SUFFIXES)}")
        if suffix == ".exr":
            return cls(*read_exr(str(source)))
        return cls(read_png(str(source)))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def save(
        self, path: str | PathLike[str], *, exposure: float = 1.0, tone: str = "linear"
    ) -> None:
        """Write the picture to a file, which appears, or is replaced, as a whole.

        Parameters
        ----------
        path : str or path
            ``.png``: sRGB, 8 bits. ``.exr``: linear float32 (needs ``raystream[exr]``), with
            the layers as further channels.
        exposure : float
            Factor on the colours of a PNG; EXR keeps them as they are.
        tone : {"linear", "reinhard", "aces"}
            Curve on the colours of a PNG, after `exposure`; see `raystream.rendering.tone`.

        Raises
        ------
        ValueError
            If the name ends in something else, `exposure` is not a number above 0, `tone` is
            unknown, or two layers would share a channel of an EXR.
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
        check_tone(tone)
        with atomic_write(target) as temporary:
            writer(self, str(temporary), exposure, tone)

    def to_bytes(self, exposure: float = 1.0, tone: str = "linear") -> NDArray[np.uint8]:
        """Encode as sRGB.

        Parameters
        ----------
        exposure : float
        tone : {"linear", "reinhard", "aces"}

        Returns
        -------
        ndarray of shape (H, W, 3), uint8
        """
        if tone == "linear":
            return encode_srgb(self.pixels, exposure)
        return encode_srgb(apply_tone(self.pixels.astype(np.float64) * exposure, tone))

    def denoise(self, *, passes: int = 5, strength: float = 4.0) -> Image:
        """Smooth the noise of a rendered picture, and keep edges.

        An edge-avoiding à-trous wavelet filter [1]_ with the weights of the spatial part of [2]_:
        pixels mix with those of the same surface whose light differs by no more than noise would.

        Parameters
        ----------
        passes : int
            Of the filter, 1 to 10; each doubles the reach. 5 reach 62 pixels to each side.
        strength : float
            How many standard deviations of light count as noise, 0 to 1e6.

        Returns
        -------
        Image
            With the same layers and figures, except ``"variance"``, which is no longer true.
            Finite: pixels that are not count as black, and light above 1e15 is cut.

        Raises
        ------
        ValueError
            If `passes` or `strength` is out of range, or a layer has another shape than that of
            its kind.
        MemoryError
            If what is needed does not fit into memory.

        Notes
        -----
        It uses the layers that the picture has: ``"normal"``, ``"depth"`` and ``"albedo"`` tell
        surfaces apart; what is seen is divided by albedo before and multiplied afterwards, so
        that textures stay sharp; ``"emission"`` has no noise, and is left as it is;
        ``"variance"`` (of each pixel's mean, by channel) says what is noise. Where there is
        none, it is not finite, ``"samples"`` is below 4, or there is emission, it is estimated
        from 7 x 7 neighbours.

        Mirrors and glass show other surfaces than their own: what is seen in them is told apart
        by its light only. Light that is rarely found but strong is taken for an outlier at its
        neighbours, so that pictures of few samples lose some brightness. A picture of one value
        is left as it is, bit for bit.

        References
        ----------
        .. [1] Dammertz, Sewtz, Hanika and Lensch, "Edge-Avoiding À-Trous Wavelet Transform for
           fast Global Illumination Filtering", High Performance Graphics 2010.
        .. [2] Schied et al., "Spatiotemporal Variance-Guided Filtering: Real-Time Reconstruction
           for Path-Traced Global Illumination", High Performance Graphics 2017.
        """
        from raystream.rendering.denoise import denoise

        return denoise(self, passes=passes, strength=strength)

    def compare(self, reference: Image) -> Comparison:
        """Measure the errors against another picture.

        Parameters
        ----------
        reference : Image
            Of the same size.

        Returns
        -------
        Comparison

        Raises
        ------
        ValueError
            If sizes differ, or no pixel is finite in both.
        """
        from raystream.rendering.compare import compare

        return compare(self, reference)

    def draw_difference(self, reference: Image, maximum: float | None = None) -> Image:
        """Draw the difference of luminance from another picture in false colours, with scales.

        Parameters
        ----------
        reference : Image
            Of the same size.
        maximum : float, optional
            Top of the scales [default: the largest difference]. Larger ones are drawn as the
            top.

        Returns
        -------
        Image
            Black where there is no difference, warm where this picture is brighter, cold where
            it is darker, green where one of them is not finite; below it two scales.

        Raises
        ------
        ValueError
            If sizes differ, or `maximum` is not a number above 0.
        """
        from raystream.rendering.compare import draw_difference

        return draw_difference(self, reference, maximum)

    def _write_png(self, target: str, exposure: float, tone: str) -> None:
        write_png(target, self.to_bytes(exposure, tone))

    def _write_exr(self, target: str, _exposure: float, _tone: str) -> None:
        write_exr(target, self.pixels, self.layers)

    def _repr_png_(self) -> bytes:
        """Show the picture in a notebook, smaller if it is larger than a screen."""
        step = -(-max(self.size) // _MOST_SHOWN)
        buffer = io.BytesIO()
        write_png(buffer, (Image(_reduced(self.pixels, step)) if step > 1 else self).to_bytes())
        return buffer.getvalue()

    def __repr__(self) -> str:
        return f"Image({self.size[0]}x{self.size[1]})"


#: Writers by the suffix of the file.
IMAGE_SUFFIXES: dict[str, Callable[[Image, str, float, str], None]] = {
    ".png": Image._write_png,
    ".exr": Image._write_exr,
}


def _reduced(pixels: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """The means of squares of so many pixels; those at the right and at the bottom have fewer."""
    for axis in (0, 1):
        length = pixels.shape[axis]
        begins = np.arange(0, length, step)
        sums = np.add.reduceat(pixels, begins, axis)
        counts = np.diff(begins, append=length).astype(np.float32)
        pixels = np.divide(sums, counts.reshape(-1, *(1,) * (2 - axis)), dtype=np.float32)
    return pixels


def _check_exposure(exposure: float) -> None:
    if not (math.isfinite(exposure) and exposure > 0.0):
        raise ValueError(f"exposure: expected a number above 0, got {exposure}")
