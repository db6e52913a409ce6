"""Elevation rasters: heights on a grid of cells, from NumPy or xarray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.rays import as_real_array

#: Names of dimensions in degrees, which heights are not measured in.
_ANGLES = frozenset(("lat", "latitude", "lon", "long", "longitude"))

#: Encoding that says where a raster is.
_PLACE = ("coordinates", "grid_mapping")


class Georeference(NamedTuple):
    """Where the cells of a raster are, as the user gave it; see `raystream.terrain`."""

    spacing: Any = None
    transform: Any = None


class Elevation(NamedTuple):
    """Heights at the centres of cells.

    Attributes
    ----------
    heights : ndarray of shape (H, W), float64
        NaN where there is no data.
    x : ndarray of shape (W,), float64
        Of the columns; increasing or decreasing.
    y : ndarray of shape (H,), float64
        Of the rows; increasing or decreasing.
    labels : xarray.DataArray or None
        The raster as it was given, if it has labels.
    """

    heights: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    labels: Any = None

    def labelled(self, values: NDArray[Any], name: str) -> Any:
        """Values of cells with the labels of the raster, if it has any.

        Flags, of dtype bool, are masked where there is no data; those with labels are float32
        then, and NaN. In files they are bytes, 255 where there is no data.
        """
        encoding: dict[str, Any] = {"_FillValue": np.nan}
        if values.dtype == np.bool_:
            encoding = {"dtype": "uint8"}
            is_missing = np.isnan(self.heights)
            if is_missing.any():
                if self.labels is None:
                    return np.ma.MaskedArray(values, is_missing)
                encoding["_FillValue"] = 255
                values = np.where(is_missing, np.float32(np.nan), values)
        if self.labels is None:
            return values
        result = self.labels.copy(data=values)
        # The rest of the raster's encoding, such as int16, is that of heights.
        places = {key: result.encoding[key] for key in _PLACE if key in result.encoding}
        result.name, result.attrs, result.encoding = name, {}, places | encoding
        return result

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights of the triangles at points, float64; NaN outside, and where there is no data.

        Parameters
        ----------
        x, y : ndarray of one shape, float64
        """
        column, across = _interval(self.x, x)
        row, along = _interval(self.y, y)
        a, b = self.heights[row, column], self.heights[row, column + 1]
        d, c = self.heights[row + 1, column], self.heights[row + 1, column + 1]
        # Two triangles for each square, split from its first corner to the opposite one.
        upper = a + _part(across, b - a) + _part(along, c - b)
        lower = a + _part(along, d - a) + _part(across, c - d)
        is_inside = (across >= 0) & (across <= 1) & (along >= 0) & (along <= 1)
        return np.where(is_inside, np.where(across >= along, upper, lower), np.nan)


def _part(weight: NDArray[np.float64], rise: NDArray[np.float64]) -> NDArray[np.float64]:
    """The product; 0 where the weight is, so that a corner needs no neighbours."""
    return np.where(weight == 0.0, 0.0, weight * rise)


def _interval(
    axis: NDArray[np.float64], values: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """The interval between two coordinates that each value is in, and where in it, 0 to 1."""
    sign = 1.0 if axis[1] > axis[0] else -1.0
    index = np.searchsorted(sign * axis, sign * values, side="right") - 1
    index = np.clip(index, 0, len(axis) - 2)
    return index, (values - axis[index]) / (axis[index + 1] - axis[index])


def is_labelled(dem: Any) -> bool:
    """Whether it is an ``xarray.DataArray``."""
    return all(hasattr(dem, name) for name in ("dims", "coords", "values", "attrs"))


def elevation_of(dem: Any, place: Georeference, nodata: float | None) -> Elevation:
    """Check a raster; see `raystream.terrain` for the arguments and errors."""
    labels = dem if is_labelled(dem) else None
    if labels is not None:
        _check_labels(labels)
        nodata = labels.attrs.get("_FillValue") if nodata is None else nodata
        dem = labels.values
    if isinstance(dem, np.ma.MaskedArray):
        dem = np.ma.filled(dem.astype(np.float64), np.nan)
    heights = as_real_array("dem", dem).astype(np.float64)
    if heights.ndim != 2 or min(heights.shape) < 2:
        raise ValueError(f"dem: expected shape (H, W), at least (2, 2), got {heights.shape}")
    if nodata is not None:
        heights[heights == nodata] = np.nan
    infinite = int(np.count_nonzero(np.isinf(heights)))
    if infinite:
        raise ValueError(f"dem: {infinite:,} heights are infinite; use NaN where there is no data")
    x, y = _axes(labels, place, heights.shape)
    return Elevation(heights, x, y, labels)


def _check_labels(labels: Any) -> None:
    if len(labels.dims) != 2:
        raise ValueError(
            f"dem: expected two dimensions, got {labels.dims}; select a band, as in dem.squeeze()"
        )
    row, column = (str(name) for name in labels.dims)
    if row == "x" or column == "y":
        raise ValueError("dem: expected rows along y; use dem.transpose('y', 'x')")
    if {row.lower(), column.lower()} & _ANGLES:
        raise ValueError(
            f"dem: dimensions {row!r}, {column!r} are angles; reproject to lengths in the unit of "
            "the heights, or rename them if they are lengths"
        )


def _axes(
    labels: Any, place: Georeference, shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates of columns and of rows."""
    named = [] if labels is None else [name for name in labels.dims if name in labels.coords]
    given = [name for name, value in place._asdict().items() if value is not None]
    if len(named) == 2:
        if given:
            raise ValueError(f"{given[0]}: dem has its own coordinates; give only one")
        y, x = (np.asarray(labels.coords[name].values) for name in named)
        return _axis(str(named[1]), x), _axis(str(named[0]), y)
    if len(given) == 2:
        raise ValueError("spacing, transform: expected only one of them")
    columns, rows = np.arange(shape[1]), np.arange(shape[0])
    if place.transform is not None:
        a, b, c, d, e, f = _numbers("transform", tuple(place.transform)[:6], 6)
        if b or d:
            raise ValueError("transform: rotated rasters are not supported; resample it north-up")
        return _axis("transform", c + a * (columns + 0.5)), _axis("transform", f + e * (rows + 0.5))
    spacing = 1.0 if place.spacing is None else place.spacing
    dx, dy = _numbers("spacing", spacing if np.ndim(spacing) else (spacing, spacing), 2)
    return _axis("spacing", dx * columns), _axis("spacing", dy * rows)


def _numbers(name: str, values: Sequence[float] | ArrayLike, count: int) -> list[float]:
    array = as_real_array(name, values)
    if array.shape != (count,):
        raise ValueError(f"{name}: expected {count} numbers, got shape {array.shape}")
    return array.astype(np.float64).tolist()


def _axis(name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    axis = as_real_array(name, values).astype(np.float64)
    steps = np.diff(axis)
    if not (np.isfinite(axis).all() and ((steps > 0).all() or (steps < 0).all())):
        raise ValueError(
            f"{name}: expected finite coordinates that increase, or decrease, from cell to cell"
        )
    return axis
