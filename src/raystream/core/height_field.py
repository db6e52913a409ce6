"""HeightField: terrain as an array of heights, without the triangles that it stands for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.masks import ALL_BITS, as_mask
from raystream.core.rays import as_host_array, as_number, as_real_array, as_vector
from raystream.core.triangles import MAX_COORDINATE

#: Kernels read this many cells of a row at once: rows of padding follow the arrays.
LANES = 4

#: Samples per band: bounds the temporaries.
_BAND = 1 << 20


class LocalField(NamedTuple):
    """A height field in a scene's local frame, as kernels read it.

    Attributes
    ----------
    heights : ndarray of shape (H * W + 4,), float32
        Row by row; NaN where there is no data, and after the end.
    x : ndarray of shape (W + 4,), float32
        Of the columns, and NaN after the end.
    y : ndarray of shape (H,), float32
    """

    heights: NDArray[np.float32]
    x: NDArray[np.float32]
    y: NDArray[np.float32]

    @property
    def byte_count(self) -> int:
        """Bytes of the arrays."""
        return self.heights.nbytes + self.x.nbytes + self.y.nbytes


class HeightField:
    """Heights over a grid, with two triangles for each cell between four neighbours.

    The corners of cell (row j, column i) are a = (i, j), b = (i + 1, j), c = (i + 1, j + 1) and
    d = (i, j + 1). Its triangles, numbers 2 * (j * (W - 1) + i) and the one after it, are a, b, c
    and a, c, d; or, where that would turn the front down, a, c, b and a, d, c.

    Parameters
    ----------
    heights : ndarray of shape (H, W), real
        Of the samples; NaN where there is no data: triangles with such a corner are missing. It
        is not copied.
    x : ndarray of shape (W,), float64
        Of the columns; increasing or decreasing.
    y : ndarray of shape (H,), float64
        Of the rows; increasing or decreasing.
    base : float
        Added to all heights.
    material_id : int

    Attributes
    ----------
    mask : int
        See `Mesh`.

    Raises
    ------
    ValueError
        If there are fewer than 2 x 2 samples, or heights are infinite or beyond 2**200.
    """

    mask: int = ALL_BITS

    def __init__(
        self,
        heights: NDArray[Any],
        x: NDArray[np.float64],
        y: NDArray[np.float64],
        base: float = 0.0,
        material_id: int = 0,
    ) -> None:
        self.heights, self.x, self.y = heights, x, y
        self.base, self.material_id = base, material_id
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise ValueError(
                f"heights: expected shape (H, W), at least (2, 2), got {heights.shape}"
            )
        self._examine()

    @classmethod
    def of(
        cls,
        heights: Any,
        origin: Any,
        spacing: Any,
        material_id: Any = 0,
        mask: int = ALL_BITS,
    ) -> HeightField:
        """Check the arguments of `Scene.height_field`."""
        array = as_host_array("heights", heights)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"heights: expected real numbers, got dtype {array.dtype}")
        if array.ndim != 2 or min(array.shape) < 2:
            raise ValueError(f"heights: expected shape (H, W), at least (2, 2), got {array.shape}")
        x0, y0, base = (float(one) for one in as_vector("origin", origin))
        steps = as_real_array("spacing", spacing).astype(np.float64)
        if steps.shape not in ((), (2,)):
            raise ValueError(f"spacing: expected one number or two, got shape {steps.shape}")
        dx, dy = np.broadcast_to(steps, 2).tolist()
        x = x0 + dx * np.arange(array.shape[1])
        y = y0 + dy * np.arange(array.shape[0])
        reach = np.max([np.abs(x).max(), np.abs(y).max(), abs(base)])
        if not reach <= MAX_COORDINATE:
            raise ValueError("origin, spacing: expected finite numbers, and samples within 2**200")
        for name, axis in (("x", x), ("y", y)):
            steps = np.diff(axis)
            if not ((steps > 0.0).all() or (steps < 0.0).all()):
                raise ValueError(
                    f"spacing: expected numbers other than 0 that move samples along {name}, got "
                    f"{spacing} at origin {(x0, y0, base)}"
                )
        number = as_number("material_id", material_id)
        if not (number >= 0 and number == int(number)):
            raise ValueError(f"material_id: expected the number of a material, got {material_id}")
        field = cls(array, x, y, base, int(number))
        field.mask = as_mask("mask", mask)
        return field

    def __len__(self) -> int:
        """The number of triangles, missing ones included."""
        return 2 * (len(self.x) - 1) * (len(self.y) - 1)

    @property
    def is_upward(self) -> bool:
        """Whether the triangles' fronts are up in the order a, b, c."""
        return bool((self.x[1] > self.x[0]) == (self.y[1] > self.y[0]))

    def _bands(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """First rows of bands, and their samples in world space, with the row after the band."""
        row_count = len(self.y)
        size = max(1, _BAND // len(self.x))
        for first in range(0, row_count - 1, size):
            rows = self.heights[first : min(first + size, row_count - 1) + 1]
            yield first, rows.astype(np.float64) + self.base

    def _examine(self) -> None:
        """Find the bounds of the triangles, and how many are missing."""
        lows, highs, missing = [], [], 0
        self._range = (np.inf, -np.inf)
        for first, band in self._bands():
            self._range = _widened(self._range, band)
            with np.errstate(invalid="ignore"):
                if (np.abs(band) > MAX_COORDINATE).any():
                    raise ValueError(
                        "heights: some are infinite or beyond 2**200; use NaN where there is no "
                        "data"
                    )
            known = ~np.isnan(band)
            rows, columns = slice(first, first + len(band)), slice(None)
            if not known.all():
                known, solid_count = _used(known)
                missing += 2 * (len(band) - 1) * (len(self.x) - 1) - solid_count
                if not solid_count:
                    continue
                band = band[known]
                held = np.flatnonzero(known.any(axis=1))
                rows = slice(first + held[0], first + held[-1] + 1)
                held = np.flatnonzero(known.any(axis=0))
                columns = slice(held[0], held[-1] + 1)
            x, y = self.x[columns], self.y[rows]
            lows.append([x.min(), y.min(), band.min()])
            highs.append([x.max(), y.max(), band.max()])
        self.missing_count = missing
        self.bounds = np.zeros((2, 3))
        if lows:
            self.bounds = np.array([np.min(lows, axis=0), np.max(highs, axis=0)])

    def with_material(self, material_id: int) -> HeightField:
        """The same field of another material."""
        field = HeightField.__new__(HeightField)
        vars(field).update(vars(self), material_id=material_id)
        return field

    @property
    def is_empty(self) -> bool:
        """Whether all triangles are missing."""
        return self.missing_count == len(self)

    def local(self, center: NDArray[np.float64], scale: float) -> LocalField:
        """The field in a local frame, with the numbers that `Triangles` of a mesh would have.

        Raises
        ------
        ValueError
            If neighbouring rows or columns are the same in float32, or the extremes of the caller's
            array have changed.
        """

        def moved(values: NDArray[np.float64], axis: int) -> NDArray[np.float32]:
            with np.errstate(over="ignore", invalid="ignore"):
                return ((values - center[axis]) * scale).astype(np.float32)

        width = len(self.x)
        x = np.full(width + LANES, np.nan, np.float32)
        x[:width], y = moved(self.x, 0), moved(self.y, 1)
        if (np.diff(x[:width]) == 0.0).any() or (np.diff(y) == 0.0).any():
            raise ValueError(
                "spacing: neighbouring samples are at the same place in float32; the scene is "
                "too large for this spacing"
            )
        heights = np.full(self.heights.size + LANES, np.nan, np.float32)
        rows = heights[: self.heights.size].reshape(self.heights.shape)
        seen = (np.inf, -np.inf)
        for first, band in self._bands():
            rows[first : first + len(band)] = moved(band, 2)
            seen = _widened(seen, band)
        if seen != self._range:
            raise ValueError("heights: the array has changed since the scene was made")
        return LocalField(heights, x, y)

    def samples_of(self, numbers: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of the corners of triangles, each of shape (N, 3), int64."""
        cells, half = np.divmod(numbers.astype(np.int64), 2)
        row, column = np.divmod(cells, len(self.x) - 1)
        rows = np.stack([row, row + half, row + 1], axis=1)
        columns = np.stack([column, column + 1, column + 1 - half], axis=1)
        order = [0, 1, 2] if self.is_upward else [0, 2, 1]
        return rows[:, order], columns[:, order]

    def corners_of(self, numbers: NDArray[Any], local: LocalField) -> NDArray[np.float64]:
        """Corners of triangles, shape (N, 3, 3), float64, local frame."""
        rows, columns = self.samples_of(numbers)
        heights = local.heights[rows * len(self.x) + columns]
        corners = np.stack([local.x[columns], local.y[rows], heights], axis=-1)
        return corners.astype(np.float64)


def _widened(extremes: tuple[float, float], band: NDArray[np.float64]) -> tuple[float, float]:
    """The lowest and highest of numbers and of a band, without NaN."""
    low, high = np.fmin.reduce(band, axis=None), np.fmax.reduce(band, axis=None)
    return float(np.fmin(low, extremes[0])), float(np.fmax(high, extremes[1]))


def _used(known: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], int]:
    """The samples that complete triangles use, and the number of these triangles."""
    a, b, c, d = known[:-1, :-1], known[:-1, 1:], known[1:, 1:], known[1:, :-1]
    first, second = a & b & c, a & c & d
    used = np.zeros(known.shape, np.bool_)
    used[:-1, :-1] |= first | second
    used[:-1, 1:] |= first
    used[1:, 1:] |= first | second
    used[1:, :-1] |= second
    return used, int(np.count_nonzero(first)) + int(np.count_nonzero(second))
