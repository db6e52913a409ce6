"""Film: accumulates samples per pixel, with their mean, variance and layers."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_choice
from raystream.core.errors import FileFormatError
from raystream.core.memory import check_memory
from raystream.core.npz import read_npz, write_npz
from raystream.jit.threads import parallel_for
from raystream.rendering.arguments import check_size
from raystream.rendering.checkpoint_arrays import CheckpointArrays, identity_bytes
from raystream.rendering.film_sums import add_light
from raystream.rendering.image import Image
from raystream.rendering.layers import LAYERS, LayerKind

#: Of checkpoint files; other versions are refused.
_VERSION = 1

#: Two sums of three float64, and a count.
_BYTES_PER_PIXEL = 56

#: Pixels whose samples a thread adds at a time.
_ADDED_PIXELS = 1 << 14

#: Names of a checkpoint's arrays, apart from those of layers.
_SUM, _SQUARES, _COUNTS = "sum", "squares", "counts"


class Film:
    """Sums of samples per pixel: the mean, its variance, and layers.

    Several threads may add samples if no two of them share a pixel; nothing else may run at the
    same time. A pixel's sums depend on the order of its own samples only.

    Parameters
    ----------
    width, height : int
        In pixels.

    Attributes
    ----------
    width, height : int
    counts : ndarray of shape (H * W,), int64
        Samples of each pixel.
    dropped : int
        Number of samples that were not finite; they count as black.

    Raises
    ------
    ValueError
        If a length is below 1, or the image is too large.
    MemoryError
        If the sums do not fit into memory.
    """

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = check_size((width, height))
        pixel_count = self.width * self.height
        check_memory(pixel_count * _BYTES_PER_PIXEL, f"sums of {width}x{height} pixels would")
        self._sum = np.zeros((pixel_count, 3))
        self._squares = np.zeros((pixel_count, 3))
        self.counts: NDArray[np.int64] = np.zeros(pixel_count, np.int64)
        self.dropped = 0
        self._layers: dict[str, _Layer] = {}
        self._lock = threading.Lock()

    def add_samples(self, first_pixel: int, radiance: NDArray[Any]) -> None:
        """Add a sample, or several, to each of N consecutive pixels, on all threads.

        Parameters
        ----------
        first_pixel : int
            Row times width plus column. Pixels may continue in the next rows.
        radiance : ndarray of shape (N, 3) or (S, N, 3), float32
            Linear RGB. A sample that is not finite in all channels counts as black.

        Raises
        ------
        ValueError
            If the shape is wrong, or pixels are out of range.
        """
        if radiance.ndim not in (2, 3) or radiance.shape[-1] != 3:
            raise ValueError(f"radiance: expected shape (N, 3) or (S, N, 3), got {radiance.shape}")
        count = radiance.shape[-2]
        pixels = self._pixels(first_pixel, count)
        light = np.ascontiguousarray(radiance, np.float32).reshape(-1, count, 3)
        sums = self._sum[pixels], self._squares[pixels], self.counts[pixels]

        def add(begin: int, end: int) -> None:
            dropped = add_light(begin, end, light, *sums)
            if dropped:
                with self._lock:
                    self.dropped += dropped

        parallel_for(add, count, _ADDED_PIXELS)

    def set_layer(self, name: str, first_pixel: int, values: NDArray[Any]) -> None:
        """Add one sample of a layer to each of N consecutive pixels.

        Parameters
        ----------
        name : {"depth", "normal", "albedo", "prim_id", "emission"}
        first_pixel : int
            As in `add_samples`.
        values : ndarray of shape (N,), or (N, 3) for normal, albedo and emission
            The layer is their mean over samples, or the first one for prim_id. Other values
            that are not finite (misses) are skipped.

        Raises
        ------
        ValueError
            If the name is unknown, the shape is wrong, or pixels are out of range.
        """
        check_choice("layer", name, LAYERS)
        kind = LAYERS[name]
        if values.ndim < 1 or values.shape[1:] != kind.shape:
            expected = "(N,)" if kind.width == 1 else "(N, 3)"
            raise ValueError(f"{name}: expected shape {expected}, got {values.shape}")
        pixels = self._pixels(first_pixel, len(values))
        with self._lock:
            if name not in self._layers:
                self._layers[name] = _Layer(kind, len(self.counts))
        self._layers[name].add(pixels, values)

    def mean(self) -> NDArray[np.float32]:
        """The mean of the samples: shape (H, W, 3), float32; black without samples."""
        mean = self._sum / np.maximum(self.counts, 1)[:, None]
        return mean.astype(np.float32).reshape(self.height, self.width, 3)

    def variance(self) -> NDArray[np.float32]:
        """Unbiased estimate of the variance of each pixel's mean.

        Returns
        -------
        ndarray of shape (H, W, 3), float32
            By channel: (Σx² - (Σx)² / n) / (n (n - 1)). Infinite for pixels of 0 or 1
            samples; never NaN.
        """
        with np.errstate(over="ignore"):
            variance = self._variance().astype(np.float32)
        return variance.reshape(self.height, self.width, 3)

    def _variance(self) -> NDArray[np.float64]:
        if not (self.counts > 1).any():
            return np.full(self._sum.shape, np.inf)
        n = np.maximum(self.counts, 2)[:, None].astype(np.float64)
        variance = (self._squares - self._sum * self._sum / n) / (n * (n - 1.0))
        np.maximum(variance, 0.0, out=variance)  # rounding
        variance[self.counts < 2] = np.inf
        return variance

    def error(self) -> float:
        """Estimate of the image's relative error.

        Returns
        -------
        float
            The root of the mean of `variance` over all pixels and channels, divided by the
            mean of the image: about the RMSE against the converged image, relative to its
            brightness. Four times the samples halve it. Infinite while a pixel has fewer than
            2 samples, or if an image whose mean is black has variance; 0 without variance.
        """
        spread = math.sqrt(float(self._variance().mean()))
        if not 0.0 < spread < math.inf:
            return spread
        brightness = float((self._sum / np.maximum(self.counts, 1)[:, None]).mean())
        return spread / brightness if brightness > 0.0 else math.inf

    def layers(self) -> dict[str, NDArray[Any]]:
        """The layers by name, with ``"variance"`` and ``"samples"``: shape (H, W) or (H, W, 3)."""
        size = (self.height, self.width)
        layers = {}
        for name, layer in self._layers.items():
            values = layer.values()
            layers[name] = values.reshape(*size, *values.shape[1:])
        layers["variance"] = self.variance()
        layers["samples"] = self.counts.astype(np.int32).reshape(size)
        return layers

    def image(self, figures: Mapping[str, Any] | None = None) -> Image:
        """The image with its layers; see `mean` and `layers`."""
        return Image(self.mean(), self.layers(), figures)

    def save(self, path: str | PathLike[str], identity: str) -> None:
        """Write all sums to a checkpoint, atomically.

        Parameters
        ----------
        path : str or path
            Ends in ``.npz``.
        identity : str
            What is rendered, as text or a JSON object: everything that samples depend on.

        Raises
        ------
        ValueError
            If the file has another suffix, or the identity is too long.
        OSError
            If the file cannot be written; an existing one is then kept.
        """
        arrays: dict[str, NDArray[Any]] = {
            "version": np.array([_VERSION]),
            "identity": identity_bytes(identity),
            "size": np.array([self.width, self.height]),
            "dropped": np.array([self.dropped]),
            _SUM: self._sum,
            _SQUARES: self._squares,
            _COUNTS: self.counts,
        }
        for name, layer in self._layers.items():
            arrays[f"{name}_{_SUM}"] = layer.sum
            arrays[f"{name}_{_COUNTS}"] = layer.counts
        write_npz(path, arrays)

    @classmethod
    def load(cls, path: str | PathLike[str], identity: str) -> Film:
        """Read a checkpoint, to resume to the same bits as without an interruption.

        Parameters
        ----------
        path : str or path
        identity : str
            As given to `save`.

        Raises
        ------
        FileFormatError
            If the file is missing, corrupt, not a checkpoint, or of another image.
        MemoryError
            If the sums do not fit into memory.
        """
        file = CheckpointArrays(path, read_npz(path))
        if file.take("version", (1,), np.int64).item() != _VERSION:
            raise FileFormatError(path, "is a checkpoint of another version of raystream")
        file.check_identity(identity)
        width, height = file.take("size", (2,), np.int64, least=1).tolist()
        pixel_count = width * height
        counts = file.take(_COUNTS, (pixel_count,), np.int64, least=0)
        sums = cls(width, height)
        sums.counts = counts
        sums._sum = file.take(_SUM, (pixel_count, 3), np.float64)
        sums._squares = file.take(_SQUARES, (pixel_count, 3), np.float64, least=0)
        sums.dropped = int(file.take("dropped", (1,), np.int64, least=0).item())
        for name, kind in LAYERS.items():
            if f"{name}_{_SUM}" in file.arrays:
                layer = sums._layers[name] = _Layer(kind, pixel_count)
                layer.sum = file.take(f"{name}_{_SUM}", layer.sum.shape, layer.sum.dtype.type)
                layer.counts = file.take(f"{name}_{_COUNTS}", (pixel_count,), np.int64, least=0)
        return sums

    def _pixels(self, first: int, count: int) -> slice:
        if first < 0 or first + count > len(self.counts):
            total = len(self.counts)
            raise ValueError(f"first_pixel: {first} to {first + count} is outside 0 to {total}")
        return slice(first, first + count)

    def __repr__(self) -> str:
        fewest, most = int(self.counts.min()), int(self.counts.max())
        samples = f"{fewest}" if fewest == most else f"{fewest} to {most}"
        return f"Film({self.width}x{self.height}, {samples} samples)"


class _Layer:
    """A layer's sums of samples, or its first samples."""

    def __init__(self, kind: LayerKind, pixel_count: int) -> None:
        self.kind = kind
        shape = (pixel_count, *kind.shape)
        is_mean = kind.fold == "mean"
        check_memory(pixel_count * (8 * kind.width + 8), f"a layer of {pixel_count:,} pixels would")
        self.sum: NDArray[Any] = (
            np.zeros(shape) if is_mean else np.full(shape, kind.empty, kind.dtype)
        )
        self.counts = np.zeros(pixel_count, np.int64)

    def add(self, pixels: slice, values: NDArray[Any]) -> None:
        sums, counts = self.sum[pixels], self.counts[pixels]
        if self.kind.fold == "first":
            sums[counts == 0] = values[counts == 0]
            counts += 1
        else:
            is_known = np.isfinite(values).reshape(len(values), -1).all(axis=1)
            where = is_known if values.ndim == 1 else is_known[:, None]
            np.add(sums, values, out=sums, where=where)
            counts += is_known

    def values(self) -> NDArray[Any]:
        """The layer, a row per pixel."""
        if self.kind.fold == "first":
            return self.sum.copy()
        counts = self.counts if self.sum.ndim == 1 else self.counts[:, None]
        mean = self.sum / np.maximum(counts, 1)
        return np.where(counts > 0, mean, self.kind.empty).astype(self.kind.dtype)
