"""Image: an image in linear RGB with layers; loading, saving and comparing."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.atomic_write import atomic_write
from raystream.rendering.color import encode_srgb
from raystream.rendering.exr import read_exr, write_exr
from raystream.rendering.layers import check_layers
from raystream.rendering.png import read_png, write_png
from raystream.rendering.tone import apply_tone, auto_exposure, check_tone

if TYPE_CHECKING:
    from raystream.rendering.compare import Comparison

#: Larger images are reduced in notebooks, which store all that they show.
_MOST_SHOWN = 2048


class Image:
    """An image in linear RGB, with optional layers.

    Parameters
    ----------
    pixels : array_like of shape (H, W, 3), float
        Linear RGB, top row first.
    layers : mapping of str to array_like of shape (H, W) or (H, W, 3), optional
        Further values per pixel: ``"depth"``, ``"normal"``, ``"albedo"``, ``"prim_id"``,
        ``"variance"`` or any other name.
    figures : mapping of str to number, str or dict, optional
        Metadata of the image, not saved to files.

    Attributes
    ----------
    pixels : ndarray of shape (H, W, 3), float32
    layers : dict of str to ndarray of shape (H, W) or (H, W, 3), float32 or int32
    figures : dict

    Raises
    ------
    ValueError
        If a shape is wrong, or a layer is not numeric.
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
        """Read an image file.

        Parameters
        ----------
        path : str or path
            ``.png``: decoded from sRGB; ``.exr``: with its layers (needs ``raystream[exr]``);
            ``.hdr``: Radiance.

        Raises
        ------
        ValueError
            If the suffix is not supported.
        FileFormatError
            If the file is missing, corrupt or too large.
        ImportError
            If it is an EXR, and OpenEXR is not installed.
        MemoryError
            If it does not fit into memory.
        """
        source = Path(path)
        suffix = source.suffix.lower()
        if suffix not in _WRITERS:
            raise ValueError(f"{source}: the name must end in {' or '.join(_WRITERS)}")
        if suffix == ".exr":
            return cls(*read_exr(str(source)))
        if suffix == ".hdr":
            from raystream.rendering.rgbe import read_rgbe  # compiled

            return cls(read_rgbe(str(source)))
        return cls(read_png(str(source)))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.pixels.shape[1], self.pixels.shape[0]

    def save(
        self,
        path: str | PathLike[str],
        *,
        exposure: float | Literal["auto"] = 1.0,
        tone: str = "linear",
    ) -> None:
        """Write the image to a file, atomically. The file names raystream as its software.

        Parameters
        ----------
        path : str or path
            ``.png``: sRGB, 8 bits. ``.exr``: linear float32 (needs ``raystream[exr]``), with
            the layers as extra channels. ``.hdr``: linear, 8 bits with a shared exponent
            (Radiance).
        exposure : float or "auto"
            Factor on the colours of a PNG; not applied to the others. ``"auto"`` chooses one that
            shows the image, see `tone.auto_exposure`.
        tone : {"linear", "reinhard", "aces"}
            Tone curve of a PNG, after `exposure`; see `raystream.rendering.tone`.

        Raises
        ------
        ValueError
            If the suffix is not supported, `exposure` is not a number above 0, `tone` is unknown,
            or two layers would share a channel of an EXR.
        ImportError
            If it is an EXR, and OpenEXR is not installed.
        OSError
            If the file cannot be written.
        """
        target = Path(path)
        writer = _WRITERS.get(target.suffix.lower())
        if writer is None:
            raise ValueError(f"{target}: the name must end in {' or '.join(_WRITERS)}")
        factor = self._factor(exposure)
        check_tone(tone)
        with atomic_write(target) as temporary:
            writer(self, str(temporary), factor, tone)

    def to_bytes(
        self, exposure: float | Literal["auto"] = 1.0, tone: str = "linear"
    ) -> NDArray[np.uint8]:
        """Encode as sRGB.

        Parameters
        ----------
        exposure : float or "auto"
            See `save`.
        tone : {"linear", "reinhard", "aces"}

        Returns
        -------
        ndarray of shape (H, W, 3), uint8
        """
        factor = self._factor(exposure)
        if tone == "linear":
            return encode_srgb(self.pixels, factor)
        return encode_srgb(apply_tone(self.pixels.astype(np.float64) * factor, tone))

    def _factor(self, exposure: float | str) -> float:
        if exposure == "auto":
            return auto_exposure(self.pixels)
        if isinstance(exposure, str) or not (math.isfinite(exposure) and exposure > 0.0):
            raise ValueError(f"exposure: expected a number above 0 or 'auto', got {exposure!r:.40}")
        return float(exposure)

    def to_png(self, exposure: float | Literal["auto"] = 1.0, tone: str = "linear") -> bytes:
        """The content of a PNG file; see `save`."""
        buffer = io.BytesIO()
        write_png(buffer, self.to_bytes(exposure, tone))
        return buffer.getvalue()

    def denoise(self, method: str | None = None) -> Image:
        """Remove noise from a rendered image, preserving edges.

        Parameters
        ----------
        method : {"oidn", "oidn-fast", "atrous"}, optional
            Open Image Denoise [1]_, a neural network on the CPU (needs ``raystream[denoise]``);
            its smaller network, which takes about half the time and leaves up to 5 % more error;
            or raystream's edge-avoiding à-trous wavelet filter [2]_, with the weights of the
            spatial part of [3]_: it averages pixels of one surface whose light differs by no more
            than noise. [default: Open Image Denoise if it is installed]

        Returns
        -------
        Image
            With the same layers and figures, except ``"variance"``, which no longer applies.
            Finite: other pixels count as black, and light is clamped to 1e15.

        Raises
        ------
        ValueError
            If `method` is unknown, or a layer has the wrong shape.
        ImportError
            If `method` is ``"oidn"`` or ``"oidn-fast"``, and Open Image Denoise is not installed.
        MemoryError
            If the buffers do not fit into memory.
        RaystreamError
            If Open Image Denoise fails.

        Notes
        -----
        Both methods use the layers of the image. ``"emission"`` has no noise and is not filtered.
        Open Image Denoise uses ``"albedo"``, and with it ``"normal"``. The à-trous filter uses
        ``"normal"``, ``"depth"`` and ``"albedo"`` to distinguish surfaces, and divides light by
        albedo, so that textures stay sharp; ``"variance"`` (of each pixel's mean, by channel)
        measures noise. Where variance is missing or not finite, ``"samples"`` is below 4, or
        there is emission, it is estimated from 7 x 7 neighbours.

        The mean luminance of the image is preserved. Filters reject strong light that few samples
        find as outliers, so a gain that varies slowly over the image then returns it to its
        region. A constant image is left unchanged, bit for bit, by the à-trous filter.

        The bits do not depend on the number of threads; those of Open Image Denoise may depend on
        its version and on the processor.

        References
        ----------
        .. [1] Áfra, "Intel Open Image Denoise", https://www.openimagedenoise.org.
        .. [2] Dammertz, Sewtz, Hanika and Lensch, "Edge-Avoiding À-Trous Wavelet Transform for
           fast Global Illumination Filtering", High Performance Graphics 2010.
        .. [3] Schied et al., "Spatiotemporal Variance-Guided Filtering: Real-Time Reconstruction
           for Path-Traced Global Illumination", High Performance Graphics 2017.
        """
        from raystream.rendering.denoise import denoise

        layers = {name: layer for name, layer in self.layers.items() if name != "variance"}
        return Image(denoise(self.pixels, self.layers, method), layers, self.figures)

    def compare(self, reference: Image) -> Comparison:
        """Compute the errors against another image.

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

        return compare(self.pixels, reference.pixels)

    def draw_difference(self, reference: Image, maximum: float | None = None) -> Image:
        """Draw the luminance difference from another image in false colours, with scale bars.

        Parameters
        ----------
        reference : Image
            Of the same size.
        maximum : float, optional
            Top of the scales [default: the largest difference]. Larger differences are clamped.

        Returns
        -------
        Image
            Black where there is no difference, warm where this image is brighter, cold where
            it is darker, green where one of them is not finite; two scale bars below.

        Raises
        ------
        ValueError
            If sizes differ, or `maximum` is not a number above 0.
        """
        from raystream.rendering.compare import draw_difference

        return Image(draw_difference(self.pixels, reference.pixels, maximum))

    def _write_png(self, target: str, exposure: float, tone: str) -> None:
        write_png(target, self.to_bytes(exposure, tone))

    def _write_exr(self, target: str, _exposure: float, _tone: str) -> None:
        write_exr(target, self.pixels, self.layers)

    def _write_hdr(self, target: str, _exposure: float, _tone: str) -> None:
        from raystream.rendering.rgbe import write_rgbe

        write_rgbe(target, self.pixels)

    def _repr_png_(self) -> bytes:
        """Show the image in a notebook, reduced if it is larger than a screen."""
        step = -(-max(self.size) // _MOST_SHOWN)
        return (Image(_reduced(self.pixels, step)) if step > 1 else self).to_png()

    def __repr__(self) -> str:
        return f"Image({self.size[0]}x{self.size[1]})"


#: Writers by file suffix.
_WRITERS: dict[str, Callable[[Image, str, float, str], None]] = {
    ".png": Image._write_png,
    ".exr": Image._write_exr,
    ".hdr": Image._write_hdr,
}


def _reduced(pixels: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Means over squares of ``step`` x ``step`` pixels, cropped at the right and bottom."""
    for axis in (0, 1):
        length = pixels.shape[axis]
        begins = np.arange(0, length, step)
        sums = np.add.reduceat(pixels, begins, axis)
        counts = np.diff(begins, append=length).astype(np.float32)
        pixels = np.divide(sums, counts.reshape(-1, *(1,) * (2 - axis)), dtype=np.float32)
    return pixels
